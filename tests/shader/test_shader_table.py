"""Tables of shaders in NumPy: their size, their error, their sampling, their file."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.small_library import measured

from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.shader import ktx2
from manifold.shader.averaged import AveragedBRDF
from manifold.shader.exporting import MOST_BYTES, make_shader
from manifold.shader.lobes import fit_lobes
from manifold.shader.table import SUMS, Shape, shapes_of, tabulate

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize(
    "shape", [Shape.of(8, 32, 48, 24, 128), Shape.of(24, 48, 16, 12, 2), Shape.of(3, 16, 24, 16, 90)]
)
def test_blocks_of_a_table_do_not_overlap(shape):
    taken = np.zeros((shape.height, shape.width), int)
    for t in range(shape.incidences):
        for block in shape.blocks(t):
            taken[block] += 1
    taken[shape.normal_row, : shape.nodes] += 1
    assert taken.max() == 1
    expected = shape.incidences * (shape.columns * shape.rows + shape.values**2) + shape.nodes
    assert taken.sum() == expected
    assert shape.bytes == 8 * taken.size


def test_a_fine_table_reproduces_its_file():
    file = measured("syn_gloss_red")
    brdf = MeasuredBRDF(file)
    lobes = fit_lobes(brdf, file.theta_i_rad)
    shape = Shape.of(len(file.theta_i_rad), file.spectra.shape[-1], 256, 128, 256)
    table = tabulate(file, shape, lobes)
    rng = np.random.default_rng(0)
    wi, wo = (
        from_spherical(np.arccos(rng.uniform(0.1, 1.0, 2000)), rng.uniform(0, 6.28, 2000)) for _ in range(2)
    )
    expected, found = brdf.eval_cos(wi, wo), table.eval_cos(wi, wo)
    # Halves have 11 bits; sums are linear between nodes where those of the file are quadratic.
    wrong = np.abs(found / expected - 1.0)
    assert np.median(wrong) < 0.001
    assert np.quantile(wrong, 0.99) < 0.02


def test_the_smallest_table_within_the_tolerance_is_chosen():
    file = measured("syn_satin_gold")
    coarse, fine = make_shader(file, tolerance=1.0), make_shader(file, tolerance=0.1)
    assert coarse.errors.ball <= 1.0
    assert fine.errors.ball <= 0.1
    assert coarse.table.shape.bytes < fine.table.shape.bytes <= MOST_BYTES
    smaller = [shape for shape in shapes_of(file, MOST_BYTES) if shape < fine.table.shape]
    assert smaller == sorted(smaller)


def test_a_tolerance_that_no_table_meets_gives_the_best_and_says_so():
    shader = make_shader(measured("syn_satin_gold"), tolerance=1e-6)
    (note,) = shader.notes
    assert note.startswith("no table of at most 1 MB is within 1e-06: this is the best, ")
    assert f"{shader.errors.ball:.2f} CIEDE2000" in note
    assert shader.table.shape.columns >= SUMS[-2][0]


def test_a_tolerance_of_zero_is_refused():
    with pytest.raises(UsageError, match="a tolerance of 0, expected more than 0"):
        make_shader(measured("syn_satin_gold"), tolerance=0.0)


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 75.0])
def test_samples_of_both_kinds_follow_the_density(satin, gloss, theta_deg):
    wi = from_spherical(np.deg2rad(theta_deg), 0.4)
    for shader in (satin, gloss):
        p = chi_square_p_value(shader.table, wi, np.random.default_rng(1), is_glossy=True)
        assert p > 1e-3 / 6  # six tests


def test_weights_of_samples_have_a_small_variance(satin, gloss):
    # A cosine alone has deviations of 2 and 20 times the mean for these materials.
    rng = np.random.default_rng(2)
    for shader in (satin, gloss):
        wi = np.broadcast_to(from_spherical(0.6, 0.0), (20_000, 3))
        wo, pdf = shader.table.sample(wi, rng.random((20_000, 2)))
        valid = pdf > 0.0
        weights = np.zeros(len(pdf))
        weights[valid] = shader.source.eval_cos(wi[valid], wo[valid]) @ LUMINANCE / pdf[valid]
        assert weights.std() / weights.mean() < 1.0
        albedo = float(shader.source.albedo(wi[0]) @ LUMINANCE)
        assert weights.mean() == pytest.approx(
            albedo, rel=5.0 * weights.std() / weights.mean() / np.sqrt(20_000) + 0.005
        )


class Brushed(WrappedBRDF):
    """A BRDF whose highlight is brighter along x."""

    def __init__(self, brdf):
        super().__init__(brdf)
        self.is_isotropic = False

    def eval(self, wi, wo):
        half = wi + wo
        along = half[..., :1] ** 2 / np.maximum(np.sum(half[..., :2] ** 2, axis=-1, keepdims=True), 1e-12)
        return self._brdf.eval(wi, wo) * (0.5 + along)


def test_an_anisotropic_material_is_averaged_with_a_note():
    isotropic = MeasuredBRDF(measured("syn_satin_gold"))
    brushed = Brushed(isotropic)
    wi, wo = from_spherical(0.5, 0.3), from_spherical(0.9, 2.5)
    assert np.allclose(
        AveragedBRDF(brushed).eval(wi, wo), isotropic.eval(wi, wo)
    )  # the mean of 0.5 + cos^2 is 1
    file = goniometer.measure(brushed, "brushed", resolution=16, n_phi_i=9)
    assert not file.is_isotropic
    shader = make_shader(file, tolerance=5.0)
    assert (
        shader.notes[0]
        == "anisotropic: averaged over all azimuths of the sample, because the table is isotropic"
    )
    expected, found = isotropic.eval(wi, wo), shader.table.eval(wi, wo)
    assert np.allclose(found, expected, rtol=0.25)  # 16 nodes per axis


def test_the_texture_is_a_ktx2_file_of_half_floats(satin):
    texels = satin.table.texels
    content = ktx2.content(texels)
    assert content[:12] == b"\xabKTX 20\xbb\r\n\x1a\n"
    head = struct.unpack_from("<9I", content, 12)
    height, width, _ = texels.shape
    assert head == (97, 2, width, height, 0, 0, 1, 1, 0)
    description, size, values, length = struct.unpack_from("<4I", content, 48)
    assert struct.unpack_from("<I", content, description) == (size,)
    assert values == description + size
    offset, stored, whole = struct.unpack_from("<3Q", content, 80)
    assert offset % 8 == 0
    assert offset >= values + length
    assert stored == whole == texels.nbytes == len(content) - offset
    assert np.array_equal(np.frombuffer(content, "<f2", offset=offset).reshape(texels.shape), texels)
