"""Surfaces as files: engines read textures as they were written, and Mitsuba renders them as they are."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import OpenImageIO
import pytest
import surface_twins
from helpers.browser import chromium
from helpers.exported_files import read_glb
from helpers.lamp_scene import under_lamp
from helpers.quick_fits import fit_quickly
from helpers.quick_pictures import draw_quickly
from helpers.small_library import small_model
from helpers.three_js import ThreeJs, node_modules
from PIL import Image
from surface_twins import CAPTIONS, workbook
from typer.testing import CliRunner

from manifold.brdf.measured import MeasuredBRDF
from manifold.cli.main import app
from manifold.colour.conversion import decode_srgb, encode_srgb, file_to_srgb, to_srgb
from manifold.colour.reflectances import spectral_changes, weights_at
from manifold.core.errors import FileFormatError, MissingFileError, UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Bands
from manifold.fit.exports.document import Export, TextureFiles
from manifold.formats import ma_t12
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.many.batch import only_run_in
from manifold.registries import TARGETS
from manifold.render import backend
from manifold.render.images import read_display, write_display
from manifold.surface import files, preview
from manifold.surface.files import mitsuba_document
from manifold.surface.lamp_pictures import files_in, in_plane, read_folder
from manifold.surface.sparkle import Flakes
from manifold.surface.tiling import Textures
from manifold.surface.written import read_surface


@pytest.fixture(scope="module", autouse=True)
def quickly_made():
    """Balls and fits of exports, at which no test here looks."""
    with pytest.MonkeyPatch.context() as patch:
        draw_quickly(patch)
        fit_quickly(patch)
        yield


@pytest.fixture(scope="module")
def printed(tmp_path_factory, library, quickly_made):
    """Output of the command, its folder, and what its JSON says."""
    folder = tmp_path_factory.mktemp("surface")
    workbook(folder / "twin.xlsx", np.random.default_rng(3))
    result = CliRunner().invoke(
        app,
        [
            "surface",
            str(folder / "twin.xlsx"),
            "-L",
            str(library),
            "-o",
            str(folder / "made"),
            "--size",
            "192",
            "--target",
            "gltf",
        ],
    )
    assert result.exit_code == 0, result.output
    return result.output, folder / "made", json.loads((folder / "made" / "twin.json").read_text())


@pytest.fixture(scope="module")
def mean(printed, tmp_path_factory):
    """The file of the mean in linear sRGB; the readings' is spectral."""
    path = tmp_path_factory.mktemp("mean") / "twin_rgb.bsdf"
    write_bsdf(path, file_to_srgb(read_bsdf(printed[1] / "twin.bsdf")))
    return path


@pytest.fixture
def textured(tmp_path):
    """A material of given textures, for any target."""
    plain = TextureFiles(tmp_path / "base.png", tmp_path / "normal.png")
    flaked = replace(plain, coat=tmp_path / "coat.png", coat_normal=tmp_path / "flakes.png")
    for path in flaked.named.values():
        write_display(path, np.full((4, 4, 3), 0.5))

    def of(target, *, with_flakes=False):
        ball = Errors(1.0)
        return Export(
            "twin",
            target.name,
            target.defaults,
            {"name": "twin"},
            ball,
            ball,
            "measured file",
            textures=flaked if with_flakes else plain,
        )

    return of


def _lit_from_below(mi, material):
    """The scene of a plane of a material, its lamp at 40 degrees on the side of negative y."""
    plane = {"type": "rectangle", "material": material}
    return mi.load_dict(under_lamp(mi, plane, in_plane(40.0)))


def test_estimated_spectra_of_points_have_their_measured_colours(rng):
    nm = np.arange(400.0, 701.0, 10.0)
    bands = Bands(tuple(nm.tolist()))
    mean = 0.3 + 0.2 * np.sin(nm / 50.0)
    ratios = np.exp(0.3 * rng.standard_normal((6, 3)))
    spectra = mean * (spectral_changes(ratios, mean, bands) @ weights_at(nm).T)
    assert spectra.min() > 0.0
    np.testing.assert_allclose(to_srgb(spectra, bands) / to_srgb(mean, bands), ratios, rtol=1e-6)
    np.testing.assert_allclose(spectral_changes(np.ones(3), mean, bands), 1.0, rtol=1e-9)


def test_info_shows_the_pictures_of_a_workbook_beside_its_readings(printed):
    shown = CliRunner().invoke(app, ["info", str(printed[1].parent / "twin.xlsx")]).output
    row = next(line.split() for line in shown.splitlines() if line.startswith("15as80"))
    assert row[1:6] == ["15,", "-65", "320", "x", "240"]
    np.testing.assert_allclose([float(v) for v in row[-3:]], 1.0, atol=0.02)  # 8 bits
    assert "15, diffuse" in shown


def test_the_glb_holds_both_textures_and_places_on_them(printed):
    document, content = read_glb(printed[1] / "twin_gltf.glb")
    material = document["materials"][0]
    assert material["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}
    assert material["normalTexture"] == {"index": 1}
    assert material["extras"]["textures"] == {
        "base_colour": "twin_gltf_base.png",
        "normal": "twin_normal.png",
    }
    for image in document["images"]:
        view = document["bufferViews"][image["bufferView"]]
        assert content[view["byteOffset"] :][:4] == b"\x89PNG"
    assert all("TEXCOORD_0" in mesh["primitives"][0]["attributes"] for mesh in document["meshes"])


def test_flakes_are_the_coat_of_gltf_with_normals_of_its_own(textured, tmp_path):
    (tmp_path / "twin.glb").write_bytes(TARGETS["gltf"].content(textured(TARGETS["gltf"], with_flakes=True)))
    document, _ = read_glb(tmp_path / "twin.glb")
    (material,) = document["materials"]
    coat = material["extensions"]["KHR_materials_clearcoat"]
    assert document["extensionsUsed"] == ["KHR_materials_clearcoat"]
    assert (coat["clearcoatFactor"], coat["clearcoatRoughnessFactor"]) == (1.0, 1.0)
    names = [document["images"][texture["source"]]["name"] for texture in document["textures"]]
    used = ("clearcoatTexture", "clearcoatRoughnessTexture", "clearcoatNormalTexture")
    assert [names[coat[key]["index"]] for key in used] == ["coat", "coat", "flakes"]
    assert names[material["normalTexture"]["index"]] == "normal"


@pytest.mark.parametrize("name", ["openpbr", "standard-surface"])
def test_flakes_are_the_coat_of_materialx_with_normals_of_its_own(name, textured, tmp_path):
    document = _read_materialx(TARGETS[name].content(textured(TARGETS[name], with_flakes=True)), tmp_path)
    (shader,) = (node for node in document.getNodes() if node.getType() == "surfaceshader")
    fed = {}
    for key in shader.getInputs():
        if (node := key.getConnectedNode()) is not None:
            index = node.getInputValue("index")
            fed[key.getName()] = (
                (node.getInput("in") or node.getInput("file")).getParent().getCategory(),
                index,
            )
    weight, roughness = TARGETS[name].coat[:2]
    assert (fed[weight], fed[roughness]) == (("extract", 0), ("extract", 1))
    mapped = {key for key, (kind, _) in fed.items() if kind == "normalmap"}
    assert mapped == {"openpbr": {"geometry_normal", "geometry_coat_normal"}}.get(
        name, {"normal", "coat_normal"}
    )
    colours = [image.getColorSpace() for image in document.getNodes("image") if image.getType() == "vector3"]
    assert len(colours) == 3  # numbers, which no colour management changes
    if name == "openpbr":
        assert shader.getInputValue("coat_darkening") == 0.0


def _read_materialx(content, folder):
    """A document, valid, with MaterialX's libraries."""
    mx = pytest.importorskip("MaterialX")
    (folder / "twin.mtlx").write_bytes(content)
    document, libraries = mx.createDocument(), mx.createDocument()
    mx.readFromXmlFile(document, str(folder / "twin.mtlx"))
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), libraries)
    document.setDataLibrary(libraries)
    valid, message = document.validate()
    assert valid, message
    return document


@pytest.mark.parametrize("name", ["openpbr", "standard-surface"])
def test_materialx_documents_are_valid_and_name_their_textures(name, textured, tmp_path):
    document = _read_materialx(TARGETS[name].content(textured(TARGETS[name])), tmp_path)
    assert {node.getInputValue("file") for node in document.getNodes("image")} == {"base.png", "normal.png"}


def test_usd_layers_read_their_textures(textured, tmp_path):
    usd, shade = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdShade")
    path = tmp_path / "twin.usda"
    path.write_bytes(TARGETS["usd"].content(textured(TARGETS["usd"])))
    stage = usd.Stage.Open(str(path))
    shaders = {p.GetName(): shade.Shader(p) for p in stage.Traverse() if p.GetTypeName() == "Shader"}
    for key, file in (("diffuseColor", "base.png"), ("normal", "normal.png")):
        source, _, _ = shaders["Preview"].GetInput(key).GetConnectedSource()
        assert source.GetPrim().GetName() == key
        assert shaders[key].GetInput("file").Get().path == f"./{file}"
    meshes = [p for p in stage.Traverse() if p.GetTypeName() == "Mesh"]
    assert all(
        len(p.GetAttribute("primvars:st").Get()) == len(p.GetAttribute("points").Get()) for p in meshes
    )


def test_scripts_of_blender_load_their_textures(textured):
    script = TARGETS["blender"].content(textured(TARGETS["blender"])).decode()
    compile(script, "twin.py", "exec")
    assert "picture('base.png', \"sRGB\")" in script
    assert "bump('normal.png', \"Normal\")" in script
    assert "coat.png" not in script
    flaked = TARGETS["blender"].content(textured(TARGETS["blender"], with_flakes=True)).decode()
    compile(flaked, "twin.py", "exec")
    assert "bump('flakes.png', \"Coat Normal\")" in flaked
    assert "picture('coat.png', \"Non-Color\")" in flaked


def test_the_command_prints_and_writes_numbers(printed):
    output, folder, numbers = printed
    assert "slopes" in output
    assert numbers["pictures"] == list(CAPTIONS)
    assert numbers["instrument"] == [{"Name": "twin", "Geometry": "15d", "Graininess": 3.5}]
    assert "Graininess 3.5" in output
    written = {path.name for path in folder.iterdir()} - {".manifold.lock"}
    assert set(numbers["files"].values()) == written
    slopes = "{:.3f} in x, {:.3f} in y".format(*numbers["slope_std"])
    assert slopes in output
    assert f"{numbers['height_std_px']:.2f} pixels" in output
    assert all(f"{100 * spread:.1f} %" in output for spread in numbers["albedo_std"])
    base = decode_srgb(read_display(folder / "twin_gltf_base.png")).mean(axis=(0, 1))
    np.testing.assert_allclose(base, base.mean(), rtol=0.05)  # of a grey twin


@pytest.mark.skipif(not backend.choose().is_llvm, reason="the plugin needs an LLVM variant")
def test_a_written_surface_is_read_again_and_shown_on_a_page(printed, tmp_path):
    folder = shutil.copytree(printed[1], tmp_path / "made")
    read = read_surface(folder)
    assert (read.name, read.textures.albedo.shape) == ("twin", (192, 192, 3))
    np.testing.assert_allclose(read.textures.albedo.mean(axis=(0, 1)), 1.0, atol=0.02)
    # Codes of 8 bits are 0.008 apart: of slopes of 0.1, the standard deviation changes by 0.03 %.
    np.testing.assert_allclose(read.textures.slope.std(axis=(0, 1)), printed[2]["slope_std"], rtol=0.01)
    np.testing.assert_allclose(read.textures.albedo.std(axis=(0, 1)), printed[2]["albedo_std"], rtol=0.02)
    np.testing.assert_allclose(read.textures.height.std(), printed[2]["height_std_px"], rtol=1e-5)
    np.testing.assert_allclose(
        0.5 + 0.5 * read.textures.normal, read_display(folder / "twin_normal.png"), atol=1 / 255
    )
    assert read.expected_ball == printed[2]["completion"]["expected"]["ball"]
    page = tmp_path / "map.html"
    asked = ["explore", "-o", str(page), "--model", str(small_model(tmp_path)), "--surface", str(folder)]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    assert '"name":"twin"' in page.read_text()


def test_a_folder_that_is_no_surface_is_refused(printed, tmp_path):
    with pytest.raises(MissingFileError, match="no surface"):
        read_surface(tmp_path)
    folder = shutil.copytree(printed[1], tmp_path / "made")
    shutil.copy(folder / "twin.bsdf", folder / "other.bsdf")
    with pytest.raises(UsageError, match=r"2 surfaces; name the JSON of one, such as other\.json"):
        read_surface(folder)
    document = folder / "twin.json"
    content = json.loads(document.read_text())
    assert read_surface(document).name == "twin"
    for named, said in ((["mean"], "not a JSON file"), ({"albedo": "a.png"}, "names no mean file")):
        document.write_text(json.dumps(content | {"files": named}))
        with pytest.raises(FileFormatError, match=said):
            read_surface(document)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"mean_srgb_linear": [0, 0, 0]}, "0 is not within 1e-06 and 1"),
        ({"mean_srgb_linear": [1e-320, 0.5, 0.5]}, "is not within 1e-06 and 1"),
        ({"mean_srgb_linear": [-1, 0.5, 1e308]}, "-1 is not within 1e-06 and 1"),
        ({"mean_srgb_linear": "abc"}, "'a' is not a number"),
        ({"mean_srgb_linear": [0.5, 0.5]}, "not a JSON file of `manifold surface`"),
        ({"completion": {"expected": {"ball": "<b>x</b>"}}}, "'<b>x</b>' is not a number"),
        ({"completion": {"expected": {"ball": {"a": 1}}}}, "is not a number"),
        ({"completion": {"expected": {"ball": True}}}, "True is not a number"),
        ({"completion": {"expected": {"ball": 10**400}}}, "is not within 0 and 1000"),
        ({"sample": ["twin"]}, "not a JSON file of `manifold surface`"),
        ({"flakes": dict.fromkeys(("density", "size_px", "slope_std", "roughness", "reflectance"), "x")}, "'x' is not"),
        ({"flakes": None}, "not a JSON file of `manifold surface`"),
    ],
)  # fmt: skip
def test_numbers_of_a_surface_are_checked_where_they_are_read(printed, tmp_path, changed, said):
    folder = shutil.copytree(printed[1], tmp_path / "made")
    document = folder / "twin.json"
    content = json.loads(document.read_text())
    if "flakes" in changed:
        content["files"]["flakes"] = content["files"]["normal"]
        changed = {"sparkle": changed}
    document.write_text(json.dumps(content | changed))
    with pytest.raises(FileFormatError, match=re.escape(said)) as error:
        read_surface(document)
    assert "\n" not in str(error.value)


def test_pictures_of_a_surface_are_of_one_size(printed, tmp_path):
    folder = shutil.copytree(printed[1], tmp_path / "made")
    with Image.open(folder / "twin_normal.png") as image:
        image.resize((96, 96)).save(folder / "twin_normal.png")
    with pytest.raises(FileFormatError, match=r"twin_normal\.png: differs in size from twin_albedo\.png"):
        read_surface(folder)


def test_mitsuba_loads_the_surface_s_document_with_its_flakes(printed):
    mi = backend.mitsuba("spectral")
    preview.bsdf.register()
    folder = printed[1]
    assert "SurfaceBSDF" in str(mi.load_file(str(folder / "twin_mitsuba.xml")))
    flakes = Flakes(50.0, 2.0, 0.3, 0.1, 0.04).drawn(192, np.random.default_rng(0))
    for name, values in (
        ("flakes", 0.5 + 0.5 * flakes.normal),
        ("weights", np.repeat(flakes.mask[..., None], 3, -1)),
    ):
        write_display(folder / f"{name}.png", values)
    named = ("normal", "changes", "mean", "flakes", "weights")
    files = ("twin_normal.png", "twin_changes.exr", "twin.bsdf", "flakes.png", "weights.png")
    paths = {name: folder / file for name, file in zip(named, files, strict=True)}
    paths["flake_weights"] = paths.pop("weights")
    (folder / "with_flakes.xml").write_text(mitsuba_document(paths, flakes))
    loaded = str(mi.load_file(str(folder / "with_flakes.xml")))
    assert all(word in loaded for word in ("SurfaceBSDF", "RoughConductor", "BlendBSDF"))


def _photographs(folder):
    """Write six photographs of 16 bits, of a painted chessboard under lamps around; return their lamps."""
    folder.mkdir()
    bright = np.exp(0.1 * surface_twins.rough(np.random.default_rng(0), (280, 300)))
    is_bright = np.kron(np.indices((4, 5)).sum(axis=0) % 2 == 0, np.ones((70, 60)))
    bright = 0.6 * (bright / bright.max() * (0.4 + 0.6 * is_bright))[..., None] * np.array([1.0, 0.8, 0.6])
    lines = []
    for k in range(6):
        values = np.round(65535 * encode_srgb(bright)).astype(np.uint16)
        spec = OpenImageIO.ImageSpec(300, 280, 3, "uint16")
        output = OpenImageIO.ImageOutput.create(str(folder / f"{k}.png"))
        output.open(str(folder / f"{k}.png"), spec)
        output.write_image(values)
        output.close()
        lines.append(f"{0.6 * np.cos(k):.6f} {0.6 * np.sin(k):.6f} 0.8")
    lamps = folder.parent / "lamps.txt"
    lamps.write_text("\n".join(lines) + "\n")
    return lamps


def test_heights_are_one_channel_with_the_scale_of_the_pictures(tmp_path):
    lamps = _photographs(tmp_path / "photos")
    words = ["surface", str(tmp_path / "photos"), "--lamp", str(lamps), "-o", str(tmp_path / "made")]
    result = CliRunner().invoke(app, [*words, "--size", "192", "--mm-per-pixel", "0.05"])
    assert result.exit_code == 0, result.output
    numbers = json.loads((tmp_path / "made" / "surface.json").read_text())
    assert "are cut" not in result.output  # though the texture shows other shares of bright and dark squares
    assert numbers["mm_per_pixel"] == 0.05
    assert f"pixels, {0.05 * numbers['height_std_px']:.2g} mm" in result.output
    height = OpenImageIO.ImageInput.open(str(tmp_path / "made" / "surface_height.exr"))
    assert (height.spec().channelnames, str(height.spec().format)) == (("Y",), "float")


@pytest.mark.parametrize("named", ["surface_albedo.png", "surface.json"])
def test_a_surface_never_replaces_its_pictures_or_lamps(named, tmp_path):
    folder = tmp_path / "photos"
    lamps = _photographs(folder)
    source = lamps if named.endswith(".json") else folder / "3.png"
    named = source.rename(folder / named)
    before = named.read_bytes()
    words = ["surface", str(folder), "--lamp", str(named if source == lamps else lamps), "-o", str(folder)]
    result = CliRunner().invoke(app, [*words, "--size", "192"])
    assert (bool(result.exit_code), named.read_bytes()) == (True, before)
    assert f"{named}: is an input of this command" in str(result.exception)
    assert not (folder / ".manifold.lock").exists()


def test_a_surface_never_replaces_its_workbook(tmp_path, library):
    workbook(tmp_path / "twin.json.xlsx", np.random.default_rng(3))
    path = (tmp_path / "twin.json.xlsx").rename(tmp_path / "twin.json")
    before = path.read_bytes()
    result = CliRunner().invoke(app, ["surface", str(path), "-L", str(library), "-o", str(tmp_path)])
    assert (bool(result.exit_code), path.read_bytes()) == (True, before)
    assert "twin.json: is an input of this command" in str(result.exception)


def test_a_batch_does_not_write_beside_its_workbooks_by_default(tmp_path, library, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "surfaces").mkdir()
    workbook(tmp_path / "surfaces" / "twin.xlsx", np.random.default_rng(3))
    result = CliRunner().invoke(app, ["surface", "surfaces", "-L", str(library), "--target", "gltf"])
    assert "surfaces: is the input folder" in str(result.exception)
    assert [path.name for path in (tmp_path / "surfaces").iterdir()] == ["twin.xlsx"]


def test_two_runs_do_not_write_a_surface_into_one_folder(tmp_path):
    lamps = _photographs(tmp_path / "photos")
    pictures = read_folder(files_in([tmp_path / "photos"]), lamps)
    with (
        only_run_in(tmp_path / "made", "results"),
        pytest.raises(UsageError, match="another run writes to this folder"),
    ):
        files.make_surface(tmp_path, pictures, None, tmp_path / "made", size=192)


def test_a_run_that_stops_leaves_no_numbers_of_other_textures(tmp_path, monkeypatch):
    lamps = _photographs(tmp_path / "photos")
    pictures = read_folder(files_in([tmp_path / "photos"]), lamps)
    made = files.make_surface(tmp_path, pictures, None, tmp_path / "made", size=192)
    assert made.paths["numbers"].is_file()

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "write_image", stopped)
    with pytest.raises(KeyboardInterrupt):
        files.make_surface(tmp_path, pictures, None, tmp_path / "made", size=200)
    assert not made.paths["numbers"].exists()


def test_a_missing_library_leaves_no_folder_behind(tmp_path):
    workbook(tmp_path / "twin.xlsx", np.random.default_rng(3))
    asked = [
        "surface",
        str(tmp_path / "twin.xlsx"),
        "-L",
        str(tmp_path / "none.zarr"),
        "-o",
        str(tmp_path / "made"),
    ]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 1
    assert "no such library" in str(result.output) + str(result.exception)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("name", ["usd-materialx", "unity"])
def test_a_target_that_takes_no_textures_is_refused(name, tmp_path):
    expected = "gltf, openpbr, standard-surface, usd, blender"
    with pytest.raises(UsageError, match=f"'{name}', expected one of {expected}"):
        files.make_surface(tmp_path, None, None, tmp_path / "made", targets=[name])


def test_surfaces_of_a_folder_go_into_one_with_a_table_and_a_sheet(tmp_path, library, monkeypatch):
    monkeypatch.setattr(files, "write_exports", lambda *_: {})
    (tmp_path / "books").mkdir()
    workbook(tmp_path / "books" / "twin.xlsx", np.random.default_rng(3))
    nm = np.arange(400.0, 701.0, 10.0)
    bare = Readings("bare", "MA-T12", *geometry_ma_t12(), nm, np.full((12, 31), 0.1))
    ma_t12.write(tmp_path / "books" / "bare.xlsx", bare)
    words = ["surface", str(tmp_path / "books"), "-L", str(library), "-o", str(tmp_path / "made"), "-j", "1"]
    words += ["--size", "192", "--target", "gltf"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1, result.output
    assert "1 surfaces in" in result.output
    rows = {row["name"]: row for row in csv.DictReader((tmp_path / "made" / "surfaces.csv").open())}
    assert float(rows["twin"]["slope"]) > 0.02
    assert "found 0 pictures" in rows["bare"]["failed"]
    made = tmp_path / "made"
    assert (made / "twin_normal.png").is_file()
    assert (made / "surfaces.png").is_file() == backend.is_available()
    assert "1 of them kept" in CliRunner().invoke(app, words).output
    normal = (made / "twin_normal.png").read_bytes()
    (made / "twin_normal.png").unlink()  # deleted
    (made / "twin_albedo.png").write_bytes(normal)  # as a killed run at another size would leave it
    assert "of them kept" not in CliRunner().invoke(app, words).output
    assert (made / "twin_normal.png").read_bytes() == normal
    assert (made / "twin_albedo.png").read_bytes() != normal


@pytest.mark.skipif(not backend.is_available(), reason="needs Mitsuba")
def test_mitsuba_shows_the_mean_under_flat_normals_and_colours_where_the_texture_has_them(mean):
    mi = backend.mitsuba("rgb")
    if "scalar" in mi.variant():
        pytest.skip("the plugin needs an LLVM variant")
    preview.bsdf.register()
    flat = np.zeros((8, 8, 3))
    flat[..., 2] = 1.0
    changes = np.ones((8, 8, 3))
    changes[:4, :, 0] = 2.0  # upper rows redder
    material = preview.material_of(mi, mean, flat, changes)
    scene = _lit_from_below(mi, material)
    picture = np.array(mi.render(scene, spp=16))
    rows = picture.shape[0]
    upper, lower = picture[rows // 8 : 3 * rows // 8], picture[5 * rows // 8 : 7 * rows // 8]  # texels blend
    upper, lower = upper.mean(axis=(0, 1)), lower.mean(axis=(0, 1))
    np.testing.assert_allclose(upper / lower, [2.0, 1.0, 1.0], rtol=0.02)
    brdf = MeasuredBRDF(read_bsdf(mean))
    light = np.array([[0.0, -np.sin(np.deg2rad(40.0)), np.cos(np.deg2rad(40.0))]])
    f = brdf.eval(np.array([[0.0, 0.0, 1.0]]), light)[0]
    np.testing.assert_allclose(lower, np.pi * f, rtol=0.03)


@pytest.mark.skipif(not backend.is_available(), reason="needs Mitsuba")
def test_mitsuba_lights_slopes_that_lean_towards_the_lamp(mean):
    mi = backend.mitsuba("rgb")
    if "scalar" in mi.variant():
        pytest.skip("the plugin needs an LLVM variant")
    preview.bsdf.register()
    normal = np.zeros((8, 8, 3))
    normal[..., 2] = 1.0
    normal[:4, :, 1], normal[4:, :, 1] = 0.2, -0.2  # upper rows lean up, lower rows down
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    material = preview.material_of(mi, mean, normal, np.ones((8, 8, 3)))
    rows = np.array(mi.render(_lit_from_below(mi, material), spp=16))
    third = rows.shape[0] // 3
    assert rows[-third:].mean() > 1.15 * rows[:third].mean()  # the lamp stands below, at negative y


def test_a_flat_surface_has_the_radiance_of_its_mean_under_every_lamp_of_its_picture(mean):
    brdf = MeasuredBRDF(read_bsdf(mean))
    flat = Textures(np.ones((192, 192, 3)), np.zeros((192, 192, 2)), np.zeros((192, 192)))
    planes = np.split(preview.strip(brdf, flat), 4, axis=1)[:3]
    for plane, angle in zip(planes, (60.0, 20.0, -50.0), strict=True):
        light = np.array([[0.0, -np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))]])
        f = brdf.eval(np.array([[0.0, 0.0, 1.0]]), light)[0]
        np.testing.assert_allclose(plane, np.broadcast_to(np.pi * f, plane.shape), rtol=1e-6)


@pytest.mark.skipif(not backend.choose().is_llvm, reason="the plugin needs an LLVM variant")
def test_the_picture_of_a_surface_is_mitsuba_s(mean, rng):
    mi = backend.mitsuba("rgb")
    preview.bsdf.register()
    slope = np.stack([0.1 * surface_twins.rough(rng, (192, 192)) for _ in range(2)], axis=-1)
    albedo = np.exp(0.2 * surface_twins.rough(rng, (192, 192)))[..., None] * np.ones(3)
    textures = Textures(albedo / albedo.mean(), slope, np.zeros((192, 192)))
    flakes = Flakes(100.0, 9.0, 0.3, 0.2, 0.04).drawn(192, rng)
    own = preview.strip(MeasuredBRDF(read_bsdf(mean)), textures, flakes)[:, 320:640]
    plane = {
        "type": "rectangle",
        "material": preview.material_of(mi, mean, textures.normal, textures.albedo, flakes),
    }
    drawn = np.array(mi.render(mi.load_dict(under_lamp(mi, plane, in_plane(20.0))), spp=16))
    assert own.std() == pytest.approx(drawn.std(), rel=0.1)  # textures are filtered otherwise
    np.testing.assert_allclose(own.mean(axis=(0, 1)), drawn.mean(axis=(0, 1)), rtol=0.02)
    blocks = [each[..., 1].reshape(80, 4, 80, 4).mean(axis=(1, 3)).ravel() for each in (own, drawn)]
    assert np.corrcoef(*blocks)[0, 1] > 0.97


def test_a_sparkling_surface_has_flakes_in_engines_whose_coats_have_normals_of_their_own(printed, tmp_path):
    folder = tmp_path / "made"
    shutil.copytree(printed[1], folder)
    flakes = Flakes(100.0, 4.0, 0.3, 0.09, 0.02).drawn(192, np.random.default_rng(0))
    flat = Textures(np.ones((192, 192, 3)), np.zeros((192, 192, 2)), np.zeros((192, 192)))
    endings = {"mean": ".bsdf", "normal": "_normal.png", "flakes": "_flakes.png", "gltf": "_gltf.glb"}
    endings |= {"usd": "_usd.usda"} | {
        f"{n}_{kind}": f"_{n}_{kind}.png" for n in ("gltf", "usd") for kind in ("base", "coat")
    }
    paths = {kind: folder / f"twin{ending}" for kind, ending in endings.items()}
    write_display(paths["flakes"], 0.5 + 0.5 * flakes.normal)
    files.write_exports(paths, flat, flakes, ("gltf", "usd"), {})
    document, _ = read_glb(folder / "twin_gltf.glb")
    assert document["materials"][0]["extras"]["textures"]["coat_normal"] == "twin_flakes.png"
    coat = read_display(folder / "twin_gltf_coat.png")[flakes.mask]
    np.testing.assert_allclose(coat, np.broadcast_to([0.5, 0.3, 0.0], coat.shape), atol=0.003)
    assert "flakes" not in paths["usd"].read_text()
    assert not paths["usd_coat"].exists()
    (note,) = files.notes_of_flakes(flakes, ("gltf", "usd"))
    assert note.startswith("usd: no flakes")


def test_three_js_lights_a_flake_under_the_lamp_that_it_faces(textured, tmp_path):
    normal, coat = (np.zeros((64, 64, 3)) for _ in range(2))
    normal[..., 2] = 1.0
    flake = (slice(16, 48), slice(16, 48))
    normal[flake] = np.array([0.0, -np.sin(np.deg2rad(20.0)), np.cos(np.deg2rad(20.0))])
    coat[flake] = 1.0, 0.3, 0.0
    content = textured(TARGETS["gltf"], with_flakes=True)
    write_display(content.textures.normal, np.full((64, 64, 3), [0.5, 0.5, 1.0]))
    write_display(content.textures.coat_normal, 0.5 + 0.5 * normal)
    write_display(content.textures.coat, coat)
    dull = dict(content.parameters) | {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    (tmp_path / "twin.glb").write_bytes(TARGETS["gltf"].content(replace(content, parameters=dull)))
    modules, above = node_modules(), [0.0, 1.0, 0.0]
    with chromium() as browser:
        page = ThreeJs(browser, modules)
        lit = {}
        for angle in (40.0, -40.0):  # positive angles towards larger rows
            lamp = [0.0, np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))]
            lit[angle] = page.ball(tmp_path / "twin.glb", above, lamp, 64, 1.0, "plane", finer=1)[..., 1]
    assert page.errors == []
    assert lit[40.0][flake].mean() > 1.5 * lit[40.0][:8].mean()
    assert lit[-40.0][flake].mean() < 1.1 * lit[-40.0][:8].mean()
