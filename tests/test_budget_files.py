"""What `manifold budget` reads and writes: files of scenes with their includes, and the folder of the answer."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time

import pytest

from manifold.errors import FileFormatError, UsageError
from manifold.experiments.budget import output_folder
from manifold.experiments.budget.output_folder import OutputFolder
from manifold.experiments.budget.scene_document import SceneDocument
from manifold.rendering import backend

SENSOR = '<sensor type="perspective"/>'
BALL = '<shape type="sphere"><bsdf type="measured"><string name="filename" value="{}"/></bsdf></shape>'


def xml(path, *parts):
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>', encoding="utf-8")
    return path


def filenames(document):
    return [material.properties["filename"] for material in document.materials]


# -- reading --------------------------------------------------------------------------------------------------


def test_materials_of_included_files_are_found_from_the_folder_of_the_scene(tmp_path):
    """As in Mitsuba 3.9: paths in included files start there too, and an earlier default goes before a later one."""
    for name in ("plain.bsdf", "inner.bsdf"):
        (tmp_path / name).touch()
    xml(tmp_path / "parts" / "inner.xml", '<default name="what" value="plain"/>', BALL.format("$what.bsdf"))
    xml(tmp_path / "parts" / "outer.xml", '<include filename="parts/$what.xml"/>', BALL.format("plain.bsdf"))
    head = '<default name="what" value="inner"/>'
    scene = xml(tmp_path / "scene.xml", head, SENSOR, '<include filename="parts/outer.xml"/>')
    document = SceneDocument.read(scene)
    assert filenames(document) == [str(tmp_path / "inner.bsdf"), str(tmp_path / "plain.bsdf")]


def test_a_scene_with_includes_is_written_so_that_it_loads_from_elsewhere(tmp_path):
    (tmp_path / "grey.bsdf").touch()
    xml(tmp_path / "objects.xml", BALL.format("grey.bsdf"))
    (tmp_path / "matte.xml").write_text('<bsdf version="3.0.0" type="diffuse"/>', encoding="utf-8")
    floor = '<shape type="disk"><include filename="matte.xml"/></shape>'
    document = SceneDocument.read(
        xml(tmp_path / "scene.xml", SENSOR, '<include filename="objects.xml"/>', floor)
    )
    (tmp_path / "out").mkdir()
    document.write(tmp_path / "out" / "scene.xml", {document.materials[0].key: {"type": "plastic"}})
    loaded = backend.mitsuba("rgb", backend.Backend("scalar")).load_file(str(tmp_path / "out" / "scene.xml"))
    assert sorted(str(shape.bsdf()).split("[")[0] for shape in loaded.shapes()) == [
        "SmoothDiffuse",
        "SmoothPlastic",
    ]


def test_files_are_looked_for_in_the_paths_of_the_scene(tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "grey.bsdf").touch()
    scene = xml(tmp_path / "scene.xml", '<path value="files"/>', SENSOR, BALL.format("grey.bsdf"))
    assert filenames(SceneDocument.read(scene)) == [str(tmp_path / "files" / "grey.bsdf")]


@pytest.mark.parametrize("name", ["deep.json", "deeper.json", "deep.xml"])
def test_scenes_nested_without_end_are_refused(tmp_path, name):
    n = 400 if name == "deep.json" else 100_000  # the parser of JSON gives up itself beyond a thousand
    path = tmp_path / name
    text = "[" * n + "]" * n if path.suffix == ".json" else "<scene>" * n + "</scene>" * n
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=f"{name}: nested (more than 100 deep|too deeply)"):
        SceneDocument.read(path)


def test_types_that_are_no_plain_names_of_plugins_are_refused(tmp_path, monkeypatch):
    """Mitsuba would load `plugins/TYPE.so`, from the folders of the scene and from the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins").mkdir()
    for path in (tmp_path / "evil.so", tmp_path / "plugins" / "evil.so"):
        path.write_text("no library")
    (tmp_path / "evil.xml").write_text('<bsdf type="../evil"/>', encoding="utf-8")
    for part in (
        '<bsdf type="../evil"/>',
        '<bsdf type="evil"/>',
        '<path value="."/><bsdf type="evil"/>',
        '<default name="t" value="../evil"/><bsdf type="$t"/>',
        '<bsdf type="$t"/>',
        '<include filename="evil.xml"/>',
        '<shape type="sphere"><bsdf type="twosided"><bsdf type=""/></bsdf></shape>',
    ):
        with pytest.raises(FileFormatError, match=r"type .*(expected the plain name|is no plugin)"):
            SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))
    for bad in ("../evil", "evil", [], {}, 7, None, "a\0b", "../" * 5000):
        content = {"type": "scene", "a": {"type": "sphere", "bsdf": [{"type": bad}]}}
        with pytest.raises(FileFormatError):
            SceneDocument.read(content)


def test_plugins_registered_in_this_process_are_taken(tmp_path):
    mi = backend.mitsuba("rgb", backend.Backend("scalar"))
    mi.register_bsdf("tested_here", lambda properties: None)
    part = '<bsdf type="tested_here"/>'
    SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))


REGISTERED = """
from manifold.rendering import backend
mi = backend.mitsuba("rgb")
class Own(mi.BSDF):
    def __init__(self, properties):
        mi.BSDF.__init__(self, properties)
        self.albedo = properties["albedo"]
mi.register_bsdf("own", Own)
print(backend.is_registered("own"), backend.is_registered("other"))
"""


def test_plugins_registered_in_the_variant_of_this_machine_are_known(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-c", REGISTERED], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.stdout.split() == ["True", "False"], ended.stderr


IN_A_FOLDER = """
from manifold.rendering import backend
mi = backend.mitsuba("rgb", backend.Backend("scalar"))
print(type(mi.load_dict({"type": "diffuse"})).__name__)
"""


def test_plugins_of_the_current_folder_do_not_take_the_place_of_mitsubas(tmp_path):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "diffuse.so").write_text("no library")
    ended = subprocess.run(
        [sys.executable, "-c", IN_A_FOLDER], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr


def test_scenes_that_grow_without_end_are_refused_at_once(tmp_path):
    chain = "".join(f'<default name="d{k}" value="{f"$d{k - 1}" * 10}"/>' for k in range(1, 40))
    laughs = xml(tmp_path / "laughs.xml", '<default name="d0" value="ha"/>', chain, SENSOR)
    for k in range(14):
        xml(tmp_path / f"level{k}.xml", f'<include filename="level{k + 1}.xml"/>' * 6)
    xml(tmp_path / "level14.xml", SENSOR)
    began = time.monotonic()
    with pytest.raises(FileFormatError, match="characters come from defaults"):
        SceneDocument.read(laughs)
    with pytest.raises(FileFormatError, match="included files"):
        SceneDocument.read(tmp_path / "level0.xml")
    assert time.monotonic() - began < 5.0  # it takes 0.1 s; without limits, for ever


@pytest.mark.parametrize("name", ["zero", "pipe", "sparse.xml"])
def test_what_has_no_end_is_not_read(tmp_path, name):
    (tmp_path / "zero").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "sparse.xml").open("wb") as stream:
        stream.truncate(100 << 30)
    spectrum = f'<emitter type="constant"><spectrum name="radiance" filename="{name}"/></emitter>'
    texture = f'<bsdf type="normalmap"><string name="filename" value="{name}"/></bsdf>'
    for part in (f'<include filename="{name}"/>', spectrum, texture):
        with pytest.raises(UsageError, match=name):
            SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))
    with pytest.raises(UsageError, match=name):
        SceneDocument.read(tmp_path / name)


def test_what_has_no_end_is_not_read_from_the_current_folder_either(tmp_path):
    """Mitsuba looks there for what it does not find beside the scene."""
    os.mkfifo(tmp_path / "pipe")
    light = '<emitter type="envmap"><string name="filename" value="pipe"/></emitter>'
    xml(tmp_path / "scenes" / "scene.xml", SENSOR, BALL.format("x"), light)
    script = "from manifold.cli.main import run; run()"
    done = subprocess.run(
        [sys.executable, "-c", script, "budget", "scenes/scene.xml"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert f"{tmp_path / 'pipe'} is not a regular file" in " ".join(done.stderr.split())


def test_a_texture_that_announces_more_than_fits_in_memory_is_refused(tmp_path):
    (tmp_path / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\0\x0f\xff\xff" * 2 + b"\x08\x02\0\0\0"
    )
    part = '<texture type="bitmap"><string name="filename" value="bomb.png"/></texture>'
    with pytest.raises(FileFormatError, match="1048575 x 1048575 pixels"):
        SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))


def test_values_that_end_mitsubas_process_or_no_number_are_refused(tmp_path):
    path = tmp_path / "scene.json"
    for text in (
        '{"type": "scene", "a": {"b": [null]}}',
        '{"type": "scene", "a": NaN}',
        '{"type": "scene", "a": ' + "9" * 5000 + "}",
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(FileFormatError, match=r"scene\.json"):
            SceneDocument.read(path)
    size = f'<film type="hdrfilm"><integer name="width" value="{"9" * 4000}"/></film>'
    sensor = f'<sensor type="perspective">{size}</sensor>'
    document = SceneDocument.read(xml(tmp_path / "scene.xml", sensor, BALL.format("x")))
    with pytest.raises(UsageError, match="size of the film") as caught:
        _ = document.film_size
    assert len(str(caught.value)) < 500


def test_includes_that_cannot_be_followed_say_why(tmp_path):
    def fails(kind, match, *parts):
        with pytest.raises(kind, match=match) as caught:
            SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, *parts))
        assert "\n" not in str(caught.value)

    fails(UsageError, r"none.xml: no such file; .*scene.xml includes it", '<include filename="none.xml"/>')
    fails(FileFormatError, "nested includes, scene.xml last", '<include filename="scene.xml"/>')
    (tmp_path / "torn.xml").write_text("<scene><shape", encoding="utf-8")
    fails(FileFormatError, r"torn.xml: .*expected a Mitsuba scene", '<include filename="torn.xml"/>')


@pytest.mark.parametrize(("width", "height"), [(0, 0), (0, 8), (-5, 10)])
def test_a_film_without_pixels_is_refused(tmp_path, width, height):
    sizes = f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
    sensor = f'<sensor type="perspective"><film type="hdrfilm">{sizes}</film></sensor>'
    document = SceneDocument.read(xml(tmp_path / "scene.xml", sensor, BALL.format("x.bsdf")))
    with pytest.raises(UsageError, match=f"found {width} x {height}, expected at least 1 x 1 pixels"):
        _ = document.film_size


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [("manifold", "colour", "#ff0000"), ("manifold", "srgb_", {"type": "rgb"}), ("measured", "alpha", 0.1)],
)
def test_properties_that_would_be_ignored_are_refused(kind, name, value):
    bsdf = {"type": kind, name: value}
    content = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    with pytest.raises(UsageError, match=f"{kind} BSDF has a property '{name}', expected .* only"):
        SceneDocument.read(content)


# -- writing --------------------------------------------------------------------------------------------------


def test_a_file_that_no_earlier_budget_wrote_is_not_replaced(tmp_path):
    (tmp_path / "scene.xml").write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match=r"scene.xml: exists, and was not written by an earlier budget"):
        OutputFolder(tmp_path, "scene.xml", [])
    (tmp_path / "scene.xml.budget.json").write_text("[" * 100_000, encoding="utf-8")  # nobody's list
    with pytest.raises(UsageError, match="exists, and was not"):
        OutputFolder(tmp_path, "scene.xml", [])
    original = tmp_path / "original"
    original.touch()
    (tmp_path / "grey_spec.bsdf").symlink_to(tmp_path / "gone")
    with pytest.raises(UsageError, match=r"grey_spec.bsdf: exists, and was not"):
        OutputFolder(tmp_path, "other.xml", ["grey_spec.bsdf"])


def test_a_later_budget_of_the_scene_replaces_the_files_of_the_earlier_alone(tmp_path):
    source = tmp_path / "source"
    source.write_bytes(b"first")
    folder = OutputFolder(tmp_path / "out", "scene.xml", ["a.bsdf"])
    folder.prepare(["a.bsdf"])
    folder.copy(source, "a.bsdf")
    source.write_bytes(b"second")
    again = OutputFolder(tmp_path / "out", "scene.xml", ["a.bsdf"])
    again.prepare(["a.bsdf"])
    assert again.copy(source, "a.bsdf").read_bytes() == b"second"
    listed = json.loads((tmp_path / "out" / "scene.xml.budget.json").read_text(encoding="utf-8"))
    assert listed["files"] == ["a.bsdf", "scene.xml", "scene.xml.budget.json"]
    with pytest.raises(UsageError, match=r"a.bsdf: exists, and was not"):
        OutputFolder(tmp_path / "out", "another.xml", ["a.bsdf"])


def test_a_link_in_the_folder_is_replaced_and_what_it_names_is_not(tmp_path):
    original, source = tmp_path / "original", tmp_path / "source"
    original.write_bytes(b"measured")
    source.write_bytes(b"reduced")
    folder = OutputFolder(tmp_path / "out", "scene.xml", ["a.bsdf"])
    folder.prepare(["a.bsdf"])
    (tmp_path / "out" / "a.bsdf").symlink_to(original)
    assert folder.copy(source, "a.bsdf").read_bytes() == b"reduced"
    assert original.read_bytes() == b"measured"


def test_a_file_that_is_read_through_a_link_in_the_folder_is_noticed(tmp_path):
    (tmp_path / "original").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "original" / "a.bsdf").touch()
    link = tmp_path / "out" / "a.bsdf"
    link.symlink_to("../original/a.bsdf")
    for folder in ("out", "original"):
        with pytest.raises(UsageError, match=r"a.bsdf: could be overwritten"):
            output_folder.require_apart(tmp_path / folder, [str(link)])
    output_folder.require_apart(tmp_path, [str(link)])


def test_a_copy_that_fails_leaves_nothing_and_names_the_file_that_could_not_be_written(tmp_path, monkeypatch):
    source = tmp_path / "source"
    source.write_bytes(b"reduced")
    folder = OutputFolder(tmp_path / "out", "scene.xml", ["a.bsdf"])
    folder.prepare(["a.bsdf"])

    def full(_source, target):
        target.write_bytes(b"red")
        raise OSError(28, "No space left on device", str(source))

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(UsageError, match=r"out/a.bsdf: cannot write this file \(No space left"):
        folder.copy(source, "a.bsdf")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["scene.xml.budget.json"]


def test_folders_that_cannot_be_made_are_told_before_they_are_needed(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to("nowhere")
    for name in ("file", "file/below", "dangling", "n" * 300):
        with pytest.raises(UsageError, match="cannot make this folder"):
            output_folder.require_makeable(tmp_path / name)
    output_folder.require_makeable(tmp_path / "new" / "below")
    assert not (tmp_path / "new").exists()
