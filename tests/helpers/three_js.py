"""Exports of glTF as three.js draws them in headless Chromium, from a folder of npm packages; nothing is fetched."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.paths import REPOSITORY

SIZE = 96
_FINER = 9  # three.js widens highlights by the change of the normal over a pixel: pixels are small, and a few are kept
EDGE = 1.02  # radii of the ball that half the picture's side shows
_HOST = "http://files.test"
_PAGE = """<!doctype html><canvas id="canvas"></canvas>
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ canvas: document.getElementById("canvas") });
const linear = { type: THREE.FloatType, colorSpace: THREE.LinearSRGBColorSpace };
const lit = async (scene, light) => {
  if (Array.isArray(light)) {
    const lamp = new THREE.DirectionalLight(0xffffff, Math.PI); // white diffusers that face it have radiance 1
    lamp.position.set(...light);
    scene.add(lamp);
    return;
  }
  const grey = new Float32Array(await (await fetch(light)).arrayBuffer()), rows = Math.sqrt(grey.length / 2);
  const around = new THREE.DataTexture(
    new Float32Array(4 * grey.length).map((_, i) => grey[i >> 2]), 2 * rows, rows, THREE.RGBAFormat, THREE.FloatType
  );
  around.mapping = THREE.EquirectangularReflectionMapping;
  around.minFilter = around.magFilter = THREE.LinearFilter;
  around.needsUpdate = true;
  scene.environment = around;
};
window.draw = async (address, shape, view, light, kept, finer, edge) => {
  const size = kept * finer;
  const { scene: loaded } = await new GLTFLoader().loadAsync(address);
  const drawn = loaded.getObjectByName(shape), scene = new THREE.Scene();
  drawn.geometry.computeBoundingBox();
  drawn.geometry.boundingBox.getCenter(drawn.position).negate();
  scene.add(drawn);
  await lit(scene, light);
  const r = drawn.geometry.boundingBox.max.x * edge;
  const camera = new THREE.OrthographicCamera(-r, r, r, -r, 0.1, 100);
  camera.position.set(...view).multiplyScalar(20 * r);
  if (shape === "plane") camera.up.set(0, 0, -1); // seen from above
  camera.lookAt(0, 0, 0);
  const target = new THREE.WebGLRenderTarget(size, size, linear);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const values = new Float32Array(4 * size * size);
  renderer.readRenderTargetPixels(target, 0, 0, size, size, values);
  const middle = (finer - 1) / 2, picture = [];
  for (let row = kept - 1; row >= 0; row--) { // from the top
    for (let column = 0; column < kept; column++) {
      const at = 4 * ((row * finer + middle) * size + column * finer + middle);
      picture.push(...values.subarray(at, at + 4));
    }
  }
  return picture;
};
document.body.dataset.ready = "";
</script>"""


def node_modules() -> Path:
    """The folder of npm packages that tests use, or a skipped test."""
    path = Path(os.environ.get("MANIFOLD_NODE_MODULES", REPOSITORY / ".venv" / "node_modules"))
    if not (path / "three").is_dir() or not (path / "gltf-validator").is_dir():
        pytest.skip(
            "no three and gltf-validator: npm install --prefix .venv three gltf-validator, or set MANIFOLD_NODE_MODULES"
        )
    return path


class ThreeJs:
    """A page with three.js."""

    def __init__(self, browser: Any, modules: Path) -> None:
        self._modules, self._files = modules, {"page.html": _PAGE.encode()}
        self._page = browser.new_page()
        self.errors: list[str] = []
        self._page.on("pageerror", lambda error: self.errors.append(str(error)))
        self._page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self._page.route("**/*", self._answer)
        self._page.goto(f"{_HOST}/page.html")
        self._page.wait_for_selector("[data-ready]", state="attached", timeout=60_000)

    def _answer(self, route: Any) -> None:
        name = route.request.url.removeprefix(f"{_HOST}/")
        content = self._files.get(name)
        if content is None and (self._modules / name).is_file():
            content = (self._modules / name).read_bytes()
        kind = {"html": "text/html", "js": "text/javascript"}.get(
            name.rpartition(".")[2], "model/gltf-binary"
        )
        if content is None:
            route.fulfill(status=404)
        else:
            route.fulfill(body=content, content_type=kind)

    def ball(
        self,
        path: Path,
        view: Sequence[float],
        light: Sequence[float] | np.ndarray,
        size: int = SIZE,
        edge: float = EDGE,
        shape: str = "ball",
        finer: int = _FINER,
    ) -> np.ndarray:
        """Radiance and alpha of a ball (size, size, 4), seen by parallel rays from `view`, up y.

        Args:
            path: of the glTF file.
            view: unit vector.
            light: where a distant lamp stands, (3,), or radiance (H, 2 H) of grey surroundings, rows from below.
            size: of the picture.
            edge: radii of the ball that half the picture's side shows.
            shape: `ball`, or `plane`, which is seen from above.
            finer: pixels across one, of which the middle one is kept.
        """
        self._files["material.glb"] = path.read_bytes()
        if np.ndim(light) == 2:
            self._files["light.bin"] = np.asarray(light, "<f4").tobytes()
        described = "/light.bin" if np.ndim(light) == 2 else [float(x) for x in light]
        script = "(how) => draw('/material.glb', ...how)"
        values = self._page.evaluate(script, [shape, list(view), described, size, finer, edge])
        return np.array(values).reshape(size, size, 4)
