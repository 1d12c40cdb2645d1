"""What `mitsuba.parser` can and cannot do of what `manifold budget` needs of scenes; see docs/design/budget.md.

python benchmarks/trial_scene_parser.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from manifold.rendering import backend

SCENE = """<scene version="3.0.0">
  <default name="width" value="32"/>
  <path value="files"/>
  <sensor type="perspective" id="camera"><film type="hdrfilm"><integer name="width" value="$width"/></film></sensor>
  <include filename="included.xml"/>
  <shape type="sphere" id="left"><ref id="gold"/></shape>
  <shape type="sphere" id="right"><bsdf type="measured"><string name="filename" value="b.bsdf"/></bsdf></shape>
</scene>"""
INCLUDED = '<bsdf version="3.0.0" type="measured" id="gold"><string name="filename" value="a.bsdf"/></bsdf>'
MATRIX = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
DEEP = """
import sys
import mitsuba as mi
mi.set_variant("scalar_rgb")
n, config = int(sys.argv[1]), mi.parser.ParserConfig("scalar_rgb")
text = '<scene version="3.0.0">' + '<bsdf type="twosided">' * n + "</bsdf>" * n + "</scene>"
mi.parser.write_string(mi.parser.parse_string(config, text))
"""


def main() -> None:
    """Parse a scene, write it back, and print what became of it."""
    mi = backend.mitsuba(colour="rgb")
    config = mi.parser.ParserConfig(mi.variant())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.xml").write_text(SCENE)
        (folder / "files").mkdir()
        (folder / "files" / "included.xml").write_text(INCLUDED)
        before = str(mi.file_resolver())
        state = mi.parser.parse_file(config, str(folder / "scene.xml"))
    found = [node.props["filename"] for node in state.nodes if node.props.plugin_name() == "measured"]
    written = mi.parser.write_string(state)
    print(f"measured BSDFs, included ones among them: {found}")
    print(
        f"names of the shapes that nothing refers to are written: {'left' in written and 'camera' in written}"
    )
    print(
        f"search paths of the process after parsing are those before it: {str(mi.file_resolver()) == before}"
    )
    scene = {"type": "scene", "ball": {"type": "sphere", "to_world": MATRIX}}
    try:
        mi.parser.parse_dict(config, json.loads(json.dumps(scene)))
        print("dictionaries of plain values: taken")
    except RuntimeError as error:
        print(f"dictionaries of plain values: {str(error).splitlines()[0][:100]}")
    for depth in (50, 5_000, 100_000):
        ended = subprocess.run([sys.executable, "-c", DEEP, str(depth)], capture_output=True, check=False)
        print(f"{depth} elements within each other: the process ends with {ended.returncode}")


if __name__ == "__main__":
    main()
