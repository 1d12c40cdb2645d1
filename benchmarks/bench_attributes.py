"""How often a material with random attributes is found on a map, within 5 % of gloss and 1 CIEDE2000.

    python benchmarks/bench_attributes.py model.h5 --targets 100

A target is a material of the library, a gloss drawn evenly in logarithms between the least and the largest of the
library, and the colour of another material. Where a target is missed, `adjust` says so. Then the gloss of every
material is changed alone, by another place of the map and by another coat: how near it comes, and how much of the
look off the highlight stays (CIEDE2000 at 45, 75 and 110 degrees from the mirror direction).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from manifold.colour.difference import colour_differences, multi_angle_pairs
from manifold.estimate.attributes import COLOUR_TOLERANCE, GLOSS_TOLERANCE, Attributes, Wanted, adjust, lab_of
from manifold.estimate.coat import with_gloss
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
            Attributes(
                {
                    "gloss_60": Wanted(gloss),
                    "lightness": Wanted(float(lightness)),
                    "chroma": Wanted(chroma),
                    "hue": Wanted(hue),
                }
            ),
        )
        gloss_off.append(abs(found.reached["gloss_60"] / gloss - 1.0))
        colour_off.append(found.difference)
        missed = gloss_off[-1] > GLOSS_TOLERANCE or colour_off[-1] > COLOUR_TOLERANCE
        silent += missed and not found.shortfalls
        moved.append(np.linalg.norm(found.place.latent - model.latent(str(start))))
    gloss_off, colour_off = np.array(gloss_off), np.array(colour_off)
    print(f"gloss within 5 %: {np.mean(gloss_off <= GLOSS_TOLERANCE):.0%}; errors of the others", end=" ")
    print(", ".join(f"{e:.0%}" for e in np.sort(gloss_off[gloss_off > GLOSS_TOLERANCE])) or "none")
    print(
        f"colour within 1 CIEDE2000: {np.mean(colour_off <= COLOUR_TOLERANCE):.0%}, largest {colour_off.max():.2f}"
    )
    print(f"missed without being said: {silent}; moved by {np.median(moved):.2f} length scales (median)")

    _change_gloss(model, rng)


def _change_gloss(model: Manifold, rng: np.random.Generator) -> None:
    wi, wo = (w[3:] for w in multi_angle_pairs())
    off: dict[str, list[tuple[float, float]]] = {"another place": [], "another coat": []}
    for name in model.names:
        brdf, units = model.predict(name), float(np.exp(rng.uniform(np.log(2.0), np.log(90.0))))
        found = adjust(model, name, Attributes({"gloss_60": Wanted(units)}))
        changed = (model.predict(found.place, found.colours), with_gloss(brdf, {60.0: units}))
        for how, made in zip(off, changed, strict=True):
            f, f_star = (np.maximum(one.eval(wi, wo), 0.0) for one in (brdf, made))
            look = float(colour_differences(f, f_star, model.bands, "D65")[0].mean())
            off[how].append((abs(gloss_units(made, [60.0])[60.0] / units - 1.0), look))
    for how, rows in off.items():
        gloss, look = np.array(rows).T
        print(
            f"{how}: gloss within 5 %: {np.mean(gloss <= GLOSS_TOLERANCE):.0%}; look off the highlight changed by "
            f"{np.median(look):.1f} CIEDE2000 in the median, 90 % below {np.quantile(look, 0.9):.1f}"
        )


if __name__ == "__main__":
    main()
