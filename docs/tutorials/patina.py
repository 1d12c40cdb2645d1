"""A ball of copper that turns green in patches: one BSDF with textures of latents, rendered by Mitsuba.

manifold corpus corpus --rgb && manifold import corpus && manifold embed
python patina.py model.h5 syn_metal_copper syn_leaf_grass patina.png
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

import manifold as mf
from manifold.render import backend, images, scenes
from manifold.render.render import rgb_film


def covered_share(height: int, width: int, seed: int = 7) -> np.ndarray:
    """How much of each texel is covered, 0 to 1, shape (height, width): smooth noise, more of it towards the top."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    noise = sum(gaussian_filter(noise, s, mode=("nearest", "wrap")) * s for s in (3.0, 9.0, 27.0))
    latitude = np.linspace(1.2, -1.2, height)[:, None]
    return 0.5 + 0.5 * np.tanh(1.5 * (noise / noise.std() + latitude))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("bare", help="material where the surface is bare")
    parser.add_argument("cover", help="material that covers it")
    parser.add_argument("output")
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--samples", type=int, default=256)
    given = parser.parse_args()

    model = mf.Manifold.load(given.model)
    mi = backend.mitsuba("rgb" if model.bands.is_rgb else "spectral")
    share = covered_share(256, 512)
    steps = np.linspace(0.0, 1.0, 65)
    path = np.array([model.between(given.bare, given.cover, t) for t in steps])
    textures = {
        f"latent_{k}": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.interp(share, steps, path[:, k]).astype(np.float32)[:, :, None]),
            "raw": True,  # numbers, not colours
        }
        for k in range(path.shape[1])
    }
    bsdf = {"type": "manifold", "model": given.model, **textures}
    scene = scenes.material_ball(mi, bsdf, rgb_film(given.size))
    picture = np.array(mi.render(mi.load_dict(scene), spp=given.samples))
    images.write_image(Path(given.output), picture)


if __name__ == "__main__":
    main()
