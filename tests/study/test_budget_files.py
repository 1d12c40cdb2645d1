"""What `manifold budget` reads and writes: files of scenes with their includes, and the folder of the answer."""

from __future__ import annotations

import subprocess
import sys

import pytest

from manifold.core.errors import FileFormatError, UsageError
from manifold.render import backend
from manifold.study.budget.scene_document import SceneDocument

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
    before = backend.search_folders()
    assert filenames(SceneDocument.read(scene)) == [str(tmp_path / "files" / "grey.bsdf")]
    assert backend.search_folders() == before


def test_types_that_are_no_plain_names_of_plugins_are_refused(tmp_path, monkeypatch):
    """Mitsuba would load `plugins/TYPE.so`, from the folders of the scene and from the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins").mkdir()
    for path in (tmp_path / "evil.so", tmp_path / "plugins" / "evil.so"):
        path.write_text("no library")
    (tmp_path / "evil.xml").write_text('<bsdf version="3.0.0" type="../evil"/>', encoding="utf-8")
    for part in (
        '<bsdf type="../evil"/>',
        '<bsdf type="evil"/>',
        '<path value="."/><bsdf type="evil"/>',
        '<default name="t" value="../evil"/><bsdf type="$t"/>',
        '<include filename="evil.xml"/>',
        '<shape type="sphere"><bsdf type="twosided"><bsdf type=""/></bsdf></shape>',
    ):
        with pytest.raises(FileFormatError, match=r"type .*(expected the plain name|is neither a plugin)"):
            SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))
    for bad in ("../evil", "evil", [], {}, 7, None, "a\0b", "../" * 5000):
        content = {"type": "scene", "a": {"type": "sphere", "bsdf": [{"type": bad}]}}
        with pytest.raises(FileFormatError):
            SceneDocument.read(content)


def test_plugins_registered_in_this_process_are_taken(tmp_path):
    mi = backend.mitsuba("rgb", backend.Backend("scalar"))
    mi.register_bsdf("tested_here", lambda properties: None)
    part = '<bsdf type="tested_here"/>'
    read = SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, BALL.format("x"), part))
    assert len(read.materials) == 1  # the measured one beside it


REGISTERED = """
from manifold.render import backend
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
from manifold.render import backend
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


def test_includes_that_cannot_be_followed_say_why(tmp_path):
    (tmp_path / "torn.xml").write_text("<scene><shape", encoding="utf-8")
    for name, match in (("none.xml", "not found"), ("scene.xml", "include"), ("torn.xml", "torn.xml")):
        with pytest.raises(UsageError, match=match) as caught:
            SceneDocument.read(xml(tmp_path / "scene.xml", SENSOR, f'<include filename="{name}"/>'))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("width", "height"), [(0, 0), (0, 8), (-5, 10)])
def test_a_film_without_pixels_is_refused(tmp_path, width, height):
    sizes = f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
    sensor = f'<sensor type="perspective"><film type="hdrfilm">{sizes}</film></sensor>'
    document = SceneDocument.read(xml(tmp_path / "scene.xml", sensor, BALL.format("x.bsdf")))
    with pytest.raises(UsageError, match=f"found {width} x {height}, expected at least 1 x 1 pixels"):
        _ = document.film_size


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [("manifold", "colour", "#ff0000"), ("manifold", "srgb_", "#ff0000"), ("measured", "alpha", 0.1)],
)
def test_properties_that_would_be_ignored_are_refused(kind, name, value):
    bsdf = {"type": kind, name: value}
    content = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    with pytest.raises(UsageError, match=f"{kind} BSDF has a property '{name}', expected .* only"):
        SceneDocument.read(content)


# -- writing --------------------------------------------------------------------------------------------------


def test_materials_with_parts_of_one_name_are_written_so_that_they_load(tmp_path):
    """Identifiers of a scene are unique; names of properties are not."""
    irregular = {"type": "irregular", "wavelengths": "300, 900", "values": "0.1, 0.2"}
    balls = {k: {"type": "sphere", "bsdf": {"type": "measured", "filename": f"{k}.bsdf"}} for k in "ab"}
    document = SceneDocument.read({"type": "scene", "camera": {"type": "perspective"}, **balls})
    bsdf = {"type": "principled", "base_color": irregular}
    document.write(tmp_path / "scene.xml", {m.key: bsdf for m in document.materials})
    loaded = backend.mitsuba("spectral", backend.Backend("scalar")).load_file(str(tmp_path / "scene.xml"))
    assert all("Principled" in str(shape.bsdf()) for shape in loaded.shapes())
