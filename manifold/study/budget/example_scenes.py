"""Three example scenes, each with a ball of a corpus material on a grey floor under one kind of light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifold.analytic import corpus
from manifold.colour.conversion import sensor_responses
from manifold.colour.illuminants import Illuminant
from manifold.core import disk
from manifold.io_rgl import write_bsdf
from manifold.registries import EXAMPLES


@dataclass(frozen=True)
class Example:
    """A scene of the package.

    Attributes:
        material: name of the material in the corpus.
        illuminant: CIE name of the light.
        dome: radiance of the surroundings, relative to the lamps.
        lamps: centre and half width of each lamp, a square that faces the ball; lengths are in radii of the ball.
    """

    material: str
    illuminant: str
    dome: float
    lamps: tuple[tuple[float, float, float, float], ...]


FELT = Example("syn_felt_yellow", "D65", 0.10, ((-4.0, -3.0, 5.0, 2.0), (5.0, -2.0, 3.0, 1.0)))
PAINT = Example("syn_satin_rose", "A", 0.06, ((-4.0, -3.0, 5.0, 1.6), (5.0, -2.0, 2.5, 0.8)))
CHROME = Example("syn_chrome_orange", "F11", 0.10, ((-4.0, -3.0, 5.0, 1.8), (4.5, -3.0, 2.5, 1.2)))

_SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="6"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="28"/>
    <transform name="to_world"><lookat origin="0, -6, 2.6" target="0, 0, 0.95" up="0, 0, 1"/></transform>
    <sampler type="multijitter"><integer name="sample_count" value="64"/></sampler>
    <film type="hdrfilm">
      <integer name="width" value="512"/><integer name="height" value="512"/><rfilter type="box"/>
    </film>
  </sensor>
  <shape type="sphere">
    <point name="center" x="0" y="0" z="1"/><float name="radius" value="1"/>
    <bsdf type="measured"><string name="filename" value="{filename}"/></bsdf>
  </shape>
  <shape type="disk">
    <transform name="to_world"><scale value="30"/></transform>
    <bsdf type="diffuse"><spectrum name="reflectance" value="0.2"/></bsdf>
  </shape>
  <emitter type="constant">{dome}</emitter>
{lamps}
</scene>
"""

_LAMP = """  <shape type="rectangle">
    <transform name="to_world">
      <scale value="{width}"/><lookat origin="{x}, {y}, {z}" target="0, 0, 1" up="0, 0, 1"/>
    </transform>
    <emitter type="area">{radiance}</emitter>
  </shape>"""


def write(name: str, folder: Path) -> Path:
    """Write one of `EXAMPLES` as `NAME.xml` with its measured file beside it; return the path of the scene."""
    example = EXAMPLES[name]
    material = next(m for m in corpus.isotropic_materials() if m.name == example.material)
    scene = folder / f"{name}.xml"
    disk.require_writable(scene)
    filename = f"{material.name}_spec.bsdf"
    write_bsdf(folder / filename, corpus.measure(material))
    lamps = [
        _LAMP.format(x=x, y=y, z=z, width=width, radiance=_radiance(example.illuminant, 4.0))
        for x, y, z, width in example.lamps
    ]
    text = _SCENE.format(
        filename=filename, dome=_radiance(example.illuminant, 4.0 * example.dome), lamps="\n".join(lamps)
    )
    disk.write_text(scene, text)
    return scene


def _radiance(illuminant: str, luminance: float) -> str:
    """Return a light's spectrum as an element, every 5 nm, scaled to a luminance."""
    light = Illuminant.named(illuminant)
    nm = np.arange(360.0, 831.0, 5.0)
    _, matching = sensor_responses(Illuminant.named("E"))
    nodes, _ = sensor_responses(light)
    power = light.at(nm) * luminance / np.sum(light.at(nodes) * matching[:, 1])
    values = ", ".join(f"{v:.5g}" for v in power)
    wavelengths = ", ".join(f"{v:g}" for v in nm)
    return (
        f'<spectrum name="radiance" type="irregular"><string name="wavelengths" value="{wavelengths}"/>'
        f'<string name="values" value="{values}"/></spectrum>'
    )
