"""Formulas that the page repeats in JavaScript and in GLSL, each by the name of the function of the package."""

from __future__ import annotations

import re
from importlib.resources import files

import numpy as np
import pytest

from manifold.analytic.free_lobes import microfacet_lobe
from manifold.brdf.plausibility import valley_depth
from manifold.colour import conversion, difference
from manifold.colour.reflectances import read_reflectance
from manifold.core.directions import from_spherical, to_rusinkiewicz
from manifold.core.errors import FileFormatError
from manifold.core.records import Bands
from manifold.estimate import attributes
from manifold.model import walks
from manifold.model.blending import blend_weights
from manifold.model.walks import Highlight

RGB = Bands(None)
D65 = conversion.srgb_to_xyz(np.ones(3))
ENDS = Bands((400.0, 700.0))
GLSL = """(formulas, expression, a, b) => {
  const { COLOUR, drawInto, makeProgram, makeTarget } = formulas, n = a.length;
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  gl.getExtension("EXT_color_buffer_float");
  const target = makeTarget(gl, n, 1);
  gl.bindTexture(gl.TEXTURE_2D, target.picture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, n, 1, 0, gl.RGBA, gl.FLOAT, null);
  const { handle, at } = makeProgram(gl, `${COLOUR}
    uniform vec3 a[${n}], b[${n}];
    out vec4 result;
    void main() { int k = int(gl_FragCoord.x); result = vec4(${expression}, 1.0); }`);
  gl.useProgram(handle);
  gl.uniform3fv(at("a"), a.flat());
  gl.uniform3fv(at("b"), b.flat());
  drawInto(gl, target);
  const values = new Float32Array(4 * n);
  gl.readPixels(0, 0, n, 1, gl.RGBA, gl.FLOAT, values);
  return a.map((_, k) => [...values.slice(4 * k, 4 * k + 3)]);
}"""


@pytest.fixture(scope="module")
def formulas(browser):
    """Call the page's formulas by their names."""
    page = browser.new_page()
    modules = [
        files("manifold.page").joinpath(f"{name}.js").read_text() for name in ("colour", "numerics", "webgl")
    ]
    page.evaluate(
        """async (source) => {
          window.formulas = await import(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
        }""",
        "\n".join(
            re.sub(r"^import .*?;\n", "", module, flags=re.MULTILINE | re.DOTALL) for module in modules
        ),
    )
    yield lambda script, *given: page.evaluate(
        f"(given) => ({script})(window.formulas, ...given)", list(given)
    )
    page.close()


def directions(rng, count):
    """Some above the horizon."""
    return from_spherical(rng.uniform(0.05, 1.5, count), rng.uniform(-np.pi, np.pi, count))


def camel_case(function):
    return re.sub("_([a-z0-9])", lambda found: found[1].upper(), function.__name__.strip("_"))


def of_page(formulas, function, rows):
    """What the page's function of the same name gives of each row of arguments."""
    return np.array(
        formulas(f"(formulas, rows) => rows.map((row) => formulas.{camel_case(function)}(...row))", rows)
    )


def in_glsl(formulas, function, a, b=None):
    """What the shaders' function of the same name gives of colours (n, 3), and others."""
    arguments = "a[k]" if b is None else "a[k], b[k]"
    value = f"{camel_case(function)}({arguments})"
    expression = value if b is None else f"vec3({value})"
    return np.array(formulas(GLSL, expression, a.tolist(), (a if b is None else b).tolist()))


@pytest.fixture
def colours(rng):
    """Linear sRGB (n, 3), dark ones, black and white among them."""
    return np.concatenate(
        [rng.random((60, 3)), 0.02 * rng.random((20, 3)), np.eye(3), [[0, 0, 0], [1, 1, 1]]]
    )


def in_lab(linear):
    return difference.to_lab(conversion.srgb_to_xyz(linear), D65)


def test_colours(formulas, colours):
    xyz, lab = conversion.srgb_to_xyz(colours), in_lab(colours)
    lch = np.array([attributes._to_lch(one) for one in lab])
    for function, rows, expected in (
        (conversion.encode_srgb, colours.reshape(-1, 1), conversion.encode_srgb(colours).ravel()),
        (conversion.decode_srgb, colours.reshape(-1, 1), conversion.decode_srgb(colours).ravel()),
        (conversion.srgb_to_xyz, colours[:, None], xyz),
        (conversion.luminance, colours[:, None], conversion.luminance(colours, RGB)),
        (difference.to_lab, xyz[:, None], lab),
        (attributes._to_lch, lab[:-2, None], lch[:-2]),  # black and white have no hue
        (attributes.from_lch, lch[:, None], lab),
    ):
        found = of_page(formulas, function, rows.tolist())
        assert np.allclose(found, expected, rtol=1e-5, atol=1e-5), function  # nine digits of the matrix


def test_colours_in_shaders(formulas, colours, rng):
    xyz, lab, others = conversion.srgb_to_xyz(colours), in_lab(colours), in_lab(rng.random(colours.shape))
    for function, given, expected in (
        (conversion.encode_srgb, colours, conversion.encode_srgb(colours)),
        (conversion.decode_srgb, colours, conversion.decode_srgb(colours)),
        (conversion.srgb_to_xyz, colours, xyz),
        (difference.to_lab, xyz, lab),
    ):
        assert np.allclose(in_glsl(formulas, function, given), expected, rtol=1e-4, atol=1e-3), function
    near = lab + rng.normal(size=lab.shape)
    for other in (others, near, lab):
        found = in_glsl(formulas, difference.delta_e_2000_lab, lab, other)[:, 0]
        assert np.allclose(found, difference.delta_e_2000_lab(lab, other), rtol=1e-3, atol=2e-3)


def test_a_reflectance_is_tinted(formulas, rng):
    identity = np.eye(3).tolist()
    for factor, lab in zip(
        0.05 + 0.6 * rng.random((10, 3)), in_lab(0.05 + 0.8 * rng.random((10, 3))), strict=True
    ):
        script = "(formulas, ...given) => formulas.tinted(...given)"
        found = np.array(formulas(script, factor.tolist(), lab.tolist(), identity, identity))
        assert np.allclose(found, attributes.tinted(factor, lab, RGB), atol=1e-3)
        found = of_page(formulas, attributes.lab_of_factor, [[factor.tolist(), identity]])
        assert np.allclose(found, attributes.lab_of_factor(factor, RGB), atol=1e-3)


@pytest.mark.parametrize("count", [5, 200])
def test_weights_of_blends(formulas, rng, count):
    X = rng.normal(size=(count, 2))
    places = np.vstack([rng.normal(size=(50, 2)) * 2.0, X[:20], X[:20] + 1e-7])
    found = of_page(formulas, blend_weights, [[x.tolist(), X.tolist(), 0.7] for x in places])
    assert np.allclose(found, blend_weights(places, X, 0.7), rtol=0, atol=1e-5)


def test_lobes_of_walks(formulas, rng):
    wi, wo = directions(rng, 50), directions(rng, 50)
    cosines = np.stack([wi[:, 2], wo[:, 2], np.cos(to_rusinkiewicz(wi, wo)[1])], axis=1)
    for alpha in (0.02, 0.3):
        found = of_page(formulas, microfacet_lobe, [[alpha, *row] for row in cosines.tolist()])
        assert np.allclose(found, microfacet_lobe(wi, wo, alpha), rtol=1e-6)
    first_two = walks.ROUGHNESSES[:2].tolist()
    positions = [0.0, 3.5, 11.0]
    found = of_page(formulas, walks.roughness_at, [[at, first_two] for at in positions])
    assert np.allclose(found, [walks.roughness_at(at) for at in positions])
    start, end = (
        Highlight(k, np.zeros(3), np.zeros(3), np.zeros(3), s, np.ones(3)) for k, s in ((9, 0.04), (2, 0.9))
    )
    shares = np.linspace(0.0, 1.0, 7)
    ends = [{"position": one.position, "strength": one.strength} for one in (start, end)]
    found = of_page(
        formulas, walks.positions_between, [[*ends, share, first_two] for share in shares.tolist()]
    )
    assert np.allclose(found, walks.positions_between(start, end, shares))


def test_valleys_and_curves(formulas, rng):
    profiles = rng.random((20, 30))
    found = of_page(formulas, valley_depth, [[row.tolist()] for row in profiles])
    assert np.allclose(found, valley_depth(profiles))
    x, y, at = np.sort(rng.random(9)), rng.random(9), rng.uniform(-0.2, 1.2, 40)
    found = of_page(formulas, np.interp, [[one, x.tolist(), y.tolist()] for one in at.tolist()])
    assert np.allclose(found, np.interp(at, x, y))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("nm,R,deviation\n400,0.5,a\n700,0.25,b\n", [0.5, 0.25]),
        ("400 0.5\r700 0.25\r", [0.5, 0.25]),
        ("# of a lamp\n700\t0.25\n\n400\t0.5", [0.5, 0.25]),
        ("400;0,5\n700;0,25", [0.5, 0.25]),
        ('"400,0" 0.5\n700 , 0,25', [0.5, 0.25]),
        ("Wavelength (nm),Reflectance (%)\n400,50\n700,0.8\n", [0.5, 0.008]),
        ("Wavelength (nm) Reflectance (%)\n400 50\n700 0.8\n", [0.5, 0.008]),
        ("# nm %R\n400 50\n700 0.8\n", [0.5, 0.008]),
        ("Comment:\nWvl\tRad. (Ref.)\tReflect. %\n400\t0.1\t50\n700\t0.1\t25\n", [0.5, 0.25]),
        ("nm;RAL 3000\n400;0,5\n700;0,25", [0.5, 0.25]),
        ("nm,red,blue\n400,0.5,0.5\n700,0.25,0.5\n", "one column of reflectance"),
        ("nm,Absorbance\n400,0.5\n700,0.25\n", "one column of reflectance"),
        ("Wavenumber (cm-1),R\n9000,0.5\n5000,0.25\n", "wavelengths in nm"),
        ("400,0,5\n700,0,25", "two columns, or headings"),
        ("400,0.5\n700,0,25", "in the line “700,0,25”"),
        ("400 50\n700 40", "percent"),
        ("0.4 0.5\n700 0.25", "wavelengths in nm"),
        ("400 0.5\n700 nan", "in the line “700 nan”"),
    ],
)
def test_spectra_are_read(formulas, tmp_path, text, expected):
    (tmp_path / "spectrum.txt").write_bytes(text.encode())
    script = "try { return readReflectance(text).values; } catch (error) { return error.message; }"
    found = formulas(f"({{ readReflectance }}, text) => {{ {script} }}", text)
    if isinstance(expected, str):
        assert expected in found
        with pytest.raises(FileFormatError):
            read_reflectance(tmp_path / "spectrum.txt", ENDS)
    else:
        assert found == expected == read_reflectance(tmp_path / "spectrum.txt", ENDS).tolist()
