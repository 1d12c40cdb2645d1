"""How often a material with random attributes is found on a map, within 5 % of gloss and 1 CIEDE2000.

    python benchmarks/bench_attributes.py model.h5 --targets 100

A target is a material of the library, a gloss drawn evenly in logarithms between the least and the largest of the
library, and the colour of another material. Where a target is missed, `adjust` says so.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from manifold.estimate.attributes import COLOUR_TOLERANCE, GLOSS_TOLERANCE, Attributes, Wanted, adjust, lab_of
from manifold.estimate.gloss import gloss_units
from manifold.model.manifold import Manifold


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("--targets", type=int, default=100)
    asked = parser.parse_args()
    model, rng = Manifold.load(asked.model), np.random.default_rng(29)
    materials = {name: model.material(name) for name in model.names}
    units = [gloss_units(brdf, [60.0])[60.0] for brdf in materials.values()]
    least, largest = np.log([max(min(units), 0.1), max(units)])
    gloss_off, colour_off, silent, moved = [], [], 0, []
    for _ in range(asked.targets):
        start, other = rng.choice(model.names, 2, replace=False)
        lightness, a, b = lab_of(materials[other])
        gloss = float(np.exp(rng.uniform(least, largest)))
        chroma, hue = float(np.hypot(a, b)), float(np.degrees(np.arctan2(b, a)) % 360.0)
        found = adjust(
            model,
            str(start),
            Attributes({60.0: Wanted(gloss)}, Wanted(float(lightness)), Wanted(chroma), Wanted(hue)),
        )
        gloss_off.append(abs(found.gloss[60.0][1] / gloss - 1.0))
        colour_off.append(found.difference)
        missed = gloss_off[-1] > GLOSS_TOLERANCE or colour_off[-1] > COLOUR_TOLERANCE
        silent += missed and not found.shortfalls
        moved.append(np.linalg.norm(found.latent - model.latent(str(start))))
    gloss_off, colour_off = np.array(gloss_off), np.array(colour_off)
    print(f"gloss within 5 %: {np.mean(gloss_off <= GLOSS_TOLERANCE):.0%}; errors of the others", end=" ")
    print(", ".join(f"{e:.0%}" for e in np.sort(gloss_off[gloss_off > GLOSS_TOLERANCE])) or "none")
    print(
        f"colour within 1 CIEDE2000: {np.mean(colour_off <= COLOUR_TOLERANCE):.0%}, largest {colour_off.max():.2f}"
    )
    print(f"missed without being said: {silent}; moved by {np.median(moved):.2f} length scales (median)")


if __name__ == "__main__":
    main()
