"""Shaders of measured files: size and error by tolerance, sampling, other forms of tables, glTF beside them, and time.

    python benchmarks/bench_shader.py FILES [--work FOLDER] [--json FILE]
    python benchmarks/bench_shader.py FILES --time [--json FILE]

FILES is a folder of .bsdf files. For each: CIEDE2000 of the ball (judged lights) and kB of the table at tolerances of
0.1, 0.3 and 1; p-values of the chi-square test of samples at three incidences; the standard deviation of
`f cos / density` over its mean, beside that of the file's own sampling; the error of the glTF export (which --work
keeps). Then the same errors for grids over half and difference angles, of cube roots in half floats, and for the sums
of the table, by size.

With --time, a ball under a lamp is drawn in one page of headless Chromium by three.js: with its MeshPhysicalMaterial,
plain and with coat, sheen and thin film, with the shader of the first file, and with a constant colour, in turns.
Chromium draws by processors here: the ratio on a graphics card is another.
"""

from __future__ import annotations

import argparse
import base64
import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from bench_exports import losses

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.browser import chromium
from helpers.chi_square import chi_square_p_value
from helpers.three_js import node_modules

from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.colour.conversion import file_to_srgb, luminance
from manifold.core.directions import from_rusinkiewicz, from_spherical, to_rusinkiewicz
from manifold.core.metrics import Errors
from manifold.core.records import Array
from manifold.io_rgl import material_name, read_bsdf
from manifold.page.tabulated_pairs import THETA_D_SHARE, THETA_H_MAX_RAD, THETA_H_POWER, largest_theta_d
from manifold.shader import code
from manifold.shader.exporting import MOST_BYTES, make_shader
from manifold.shader.lobes import fit_lobes
from manifold.shader.table import SUMS, TEXEL_BYTES, Shape, shapes_of, tabulate

TOLERANCES = (0.1, 0.3, 1.0)
INCIDENCES_DEG = (10.0, 45.0, 75.0)
GRIDS = ((45, 23, 12), (64, 32, 24), (90, 45, 24))
_SAMPLES = 20_000


def half_difference(brdf: MeasuredBRDF, shape: tuple[int, int, int], wi: Array, wo: Array) -> Array:
    """f of a material from a grid over theta_h, theta_d and phi_d as the explorer page has it, in half floats."""
    h, d, p = (np.arange(n) / (n - 1) for n in shape)
    theta_h, share, phi_d = (
        a.ravel()
        for a in np.meshgrid(h**THETA_H_POWER * THETA_H_MAX_RAD, d * THETA_D_SHARE, p * np.pi, indexing="ij")
    )
    pairs = from_rusinkiewicz(theta_h, share * largest_theta_d(theta_h, phi_d), phi_d)
    mirror = np.array([1.0, -1.0, 1.0])
    roots = 0.5 * sum(np.cbrt(brdf.eval(pairs[0] * side, pairs[1] * side)) for side in (1.0, mirror))
    table = (roots * np.cbrt(pairs[0][:, 2] * pairs[1][:, 2])[:, None]).astype(np.float16).astype(float)
    table = table.reshape(*shape, 3)
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    at = (
        np.clip(theta_h / THETA_H_MAX_RAD, 0.0, 1.0) ** (1.0 / THETA_H_POWER),
        np.clip(theta_d / largest_theta_d(theta_h, phi_d) / THETA_D_SHARE, 0.0, 1.0),
        np.abs(phi_d) / np.pi,
    )
    cells = [np.minimum((a * (n - 1)).astype(int), n - 2) for a, n in zip(at, shape, strict=True)]
    inside = [a * (n - 1) - cell for a, n, cell in zip(at, shape, cells, strict=True)]
    root = np.zeros((len(wi), 3))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([t if k else 1.0 - t for k, t in zip(corner, inside, strict=True)], axis=0)
        root += weight[:, None] * table[tuple(cell + k for cell, k in zip(cells, corner, strict=True))]
    return (root / np.cbrt(np.maximum(wi[:, 2] * wo[:, 2], 1e-9))[:, None]) ** 3


def deviation(sampler: Any, brdf: MeasuredBRDF, theta_deg: float) -> float:
    """Standard deviation over mean of f cos / density, of luminances."""
    rng = np.random.default_rng(0)
    wi = np.broadcast_to(from_spherical(np.deg2rad(theta_deg), 0.3), (_SAMPLES, 3))
    wo, pdf = sampler.sample(wi, rng.random((_SAMPLES, 2)))
    valid = pdf > 0.0
    weights = np.zeros(_SAMPLES)
    weights[valid] = luminance(brdf.eval_cos(wi[valid], wo[valid]), brdf.bands) / pdf[valid]
    return float(weights.std() / weights.mean())


def of_file(path: Path) -> dict[str, Any]:
    """All figures of a file."""
    file = fill_unmeasured(read_bsdf(path))
    brdf, srgb, lights = MeasuredBRDF(file), file_to_srgb(file), panel.judged()
    seen, lobes = lights.xyz(values_at(brdf, lights), brdf.bands), fit_lobes(brdf, file.theta_i_rad)
    found: dict[str, Any] = {}

    def errors(f: Array) -> Errors[float]:
        return lights.compare(seen, lights.xyz(f, srgb.bands))

    def ball(f: Array) -> float:
        return errors(f).ball

    wanted = sorted(TOLERANCES, reverse=True)
    for shape in shapes_of(srgb, MOST_BYTES):  # as `make_shader`
        table = tabulate(srgb, shape, lobes)
        seen_errors = errors(table.eval(lights.wi, lights.wo))
        while wanted and seen_errors.ball <= wanted[0]:
            found[f"{wanted.pop(0):g}"] = {
                "ball": seen_errors.ball, "worst": seen_errors.worst, "kB": shape.bytes / 1000,
                "shape": [shape.values, shape.columns, shape.rows],
            }  # fmt: skip
        if not wanted:
            break
    rng = np.random.default_rng(0)
    found["p_values"] = [
        chi_square_p_value(
            table, from_spherical(np.deg2rad(t), 0.3), rng, n_samples=50_000, order=4, is_glossy=True
        )
        for t in INCIDENCES_DEG
    ]
    found["alphas"] = lobes.alphas.tolist()
    for name, sampler in (("deviations", table), ("own_deviations", brdf)):
        found[name] = [deviation(sampler, brdf, t) for t in INCIDENCES_DEG]
    in_rgb = MeasuredBRDF(srgb)
    found["grids"] = [ball(half_difference(in_rgb, shape, lights.wi, lights.wo)) for shape in GRIDS]
    shapes = [Shape.of(len(file.theta_i_rad), file.spectra.shape[-1], *sums, 128) for sums in SUMS]
    found["sums"] = [ball(tabulate(srgb, shape, lobes).eval(lights.wi, lights.wo)) for shape in shapes]
    found["sums_kB"] = [shape.bytes / 1000 for shape in shapes]
    return found


def figures(files: Path, work: Path) -> dict[str, Any]:
    """Figures of all files, and their summaries."""
    each = {}
    for path in sorted(files.rglob("*.bsdf")):
        each[material_name(path)] = of_file(path)
        print(material_name(path), json.dumps(each[material_name(path)]), file=sys.stderr)
    for name, loss in losses(files, "gltf", work).items():
        each[name]["gltf"] = loss["own"]
        print(_row(name, each[name]))
    made: dict[str, Any] = {"files": each}
    for tolerance in TOLERANCES:
        rows = [one[f"{tolerance:g}"] for one in each.values()]
        for key in ("ball", "worst", "kB"):
            made[f"{key}_at_{tolerance:g}"] = _summary([row[key] for row in rows])
    made["gltf"] = _summary([one["gltf"] for one in each.values()])
    made["grids"] = {
        "x".join(map(str, shape)): {"kB": TEXEL_BYTES * int(np.prod(shape)) / 1000, "ball": _summary(balls)}
        for shape, balls in zip(
            GRIDS, zip(*(one["grids"] for one in each.values()), strict=True), strict=True
        )
    }
    made["sums"] = {
        "x".join(map(str, sums)): {
            "kB": statistics.median(one["sums_kB"][k] for one in each.values()),
            "ball": _summary([one["sums"][k] for one in each.values()]),
        }
        for k, sums in enumerate(SUMS)
    }
    p = [value for one in each.values() for value in one["p_values"]]
    made["p_values"] = {"least": min(p), "below_5_percent": sum(value < 0.05 for value in p), "count": len(p)}
    for name in ("deviations", "own_deviations"):
        made[name] = _summary([value for one in each.values() for value in one[name]])
    return made


def _summary(values: Any) -> list[float]:
    """Median, 90th percentile and largest."""
    return [float(np.median(values)), float(np.percentile(values, 90)), float(np.max(values))]


def _row(name: str, one: dict[str, Any]) -> str:
    cells = [f"{one[f'{t:g}']['ball']:.2f} ({one[f'{t:g}']['kB']:.0f} kB)" for t in TOLERANCES]
    cells += [f"{one['gltf']:.2f}", ", ".join(f"{p:.2f}" for p in one["p_values"])]
    cells += [", ".join(f"{v:.2f}" for v in one[key]) for key in ("deviations", "own_deviations")]
    return f"| {name} | {' | '.join(cells)} |"


_PAGE = """<!doctype html><script type="importmap">{"imports": {"three": "/three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
const SIZE = 512, FRAMES = 8;
const renderer = new THREE.WebGLRenderer();
const target = new THREE.WebGLRenderTarget(SIZE, SIZE, { type: THREE.FloatType });
const camera = new THREE.OrthographicCamera(-1.02, 1.02, 1.02, -1.02, 0.1, 10);
camera.position.z = 4;
const { code, width, height, halves } = await (await fetch("/shader.json")).json();
const bytes = Uint8Array.from(atob(halves), (c) => c.charCodeAt(0)).buffer;
const table = new THREE.DataTexture(new Uint16Array(bytes), width, height, THREE.RGBAFormat, THREE.HalfFloatType);
table.minFilter = table.magFilter = THREE.LinearFilter;
table.needsUpdate = true;
const lamp = new THREE.DirectionalLight(0xffffff, Math.PI);
lamp.position.set(1, 1, 2);
const vertexShader = `out vec3 n;
  void main() { n = normalMatrix * normal; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
const shaded = (fragmentShader, uniforms = {}) =>
  new THREE.ShaderMaterial({ glslVersion: THREE.GLSL3, vertexShader, fragmentShader, uniforms });
const materials = {
  physical: new THREE.MeshPhysicalMaterial({ color: 0xa08050, roughness: 0.4, metalness: 0.2 }),
  layered: new THREE.MeshPhysicalMaterial(
    { color: 0xa08050, roughness: 0.4, clearcoat: 1, sheen: 0.5, iridescence: 0.5 }
  ),
  shader: shaded(`${code}
    in vec3 n;
    out vec4 result;
    void main() {
      vec3 z = normalize(n), x = normalize(cross(vec3(0.0, 1.0, 1e-3), z)), lamp = normalize(vec3(1.0, 1.0, 2.0));
      mat3 frame = mat3(x, cross(z, x), z);
      result = vec4(3.14159265 * manifold_eval(vec3(0.0, 0.0, 1.0) * frame, lamp * frame), 1.0);
    }`, { manifold_table: { value: table } }),
  constant: shaded("out vec4 result; void main() { result = vec4(0.5); }"),
};
const geometry = new THREE.SphereGeometry(1, 64, 32);
const scenes = Object.fromEntries(Object.entries(materials).map(([name, material]) => {
  const scene = new THREE.Scene();
  scene.add(lamp.clone(), new THREE.Mesh(geometry, material));
  return [name, scene];
}));
const pixel = new Float32Array(4);
window.time = (rounds) => {
  const found = Object.fromEntries(Object.keys(scenes).map((name) => [name, []]));
  renderer.setRenderTarget(target);
  for (let round = -1; round < rounds; round++) { // the first one compiles
    for (const [name, scene] of Object.entries(scenes)) {
      const before = performance.now();
      for (let frame = 0; frame < FRAMES; frame++) renderer.render(scene, camera);
      renderer.readRenderTargetPixels(target, SIZE / 2, SIZE / 2, 1, 1, pixel);
      if (round >= 0) found[name].push((performance.now() - before) / FRAMES);
    }
  }
  return found;
};
document.body.dataset.ready = "";
</script>"""


def times(path: Path, rounds: int = 15) -> dict[str, Any]:
    """Milliseconds of a frame by material, medians of rounds in turns, and ratios of those beyond a constant colour."""
    shader = make_shader(read_bsdf(path))
    height, width, _ = shader.table.texels.shape
    described = {
        "code": code.glsl(shader.table, shader.name), "width": width, "height": height,
        "halves": base64.b64encode(shader.table.texels.tobytes()).decode(),
    }  # fmt: skip
    modules = node_modules()
    with chromium() as browser:
        page = browser.new_page()
        page.on("console", lambda message: print(message.text) if message.type == "error" else None)

        def answer(route: Any) -> None:
            name = route.request.url.removeprefix("http://files.test/")
            made = {"page.html": _PAGE, "shader.json": json.dumps(described)}
            if name in made or (modules / name).is_file():
                kinds = {"html": "text/html", "js": "text/javascript", "json": "application/json"}
                body = made.get(name) or (modules / name).read_bytes()
                route.fulfill(body=body, content_type=kinds[name.rpartition(".")[2]])
            else:
                route.fulfill(status=404)

        page.route("**/*", answer)
        page.goto("http://files.test/page.html")
        page.wait_for_selector("[data-ready]", state="attached", timeout=120_000)
        page.set_default_timeout(0)
        found = page.evaluate("(rounds) => time(rounds)", rounds)
    made: dict[str, Any] = {"material": shader.name, "milliseconds": {}, "fetches": 6}
    each = {name: np.array(values) for name, values in found.items()}
    made["milliseconds"] = {name: float(np.median(values)) for name, values in each.items()}
    for name in ("physical", "layered"):
        made[f"over_{name}"] = float(np.median(each["shader"] / each[name]))
        beyond = each["shader"] - each["constant"], each[name] - each["constant"]
        made[f"over_{name}_beyond_constant"] = float(np.median(beyond[0]) / np.median(beyond[1]))
    return made


def main() -> None:
    """Print the figures, and write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", type=Path)
    parser.add_argument("--time", action="store_true")
    parser.add_argument("--work", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        first = min(options.files.rglob("*.bsdf"))
        made = times(first) if options.time else figures(options.files, options.work or Path(scratch))
    print(json.dumps({name: value for name, value in made.items() if name != "files"}, indent=1))
    if options.json:
        options.json.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
