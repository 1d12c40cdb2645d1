"""Balls of materials: measured, and as a target of exports draws them.

    python benchmarks/exported_balls.py balls.png FILE ... [--target gltf]

A file with a fit beside it (`NAME.fit.json`) is not fitted again. Shown in docs/explanation/fits.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import manifold as mf
from manifold.fit import exporting, fit_samples
from manifold.fit.exports.direct import fit_target
from manifold.fit.exports.principled_values import Principled
from manifold.fit.exports.targets import TargetBRDF
from manifold.records import Array
from manifold.registries import TARGETS
from manifold.render import images


class ExportedBRDF(TargetBRDF):
    """A target's shading model as it is rendered."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., 3)."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)


def main() -> None:
    """Render the balls: a column for each file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("output", type=Path)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--target", choices=TARGETS, default="gltf")
    given = parser.parse_args()
    target = TARGETS[given.target]
    columns = []
    for path in given.files:
        fit = path.with_name(path.name.replace("_rgb.bsdf", ".fit.json"))
        subject = exporting.subject_of(fit, path) if fit.exists() else exporting.subject_of(path, None)
        assert subject.material is not None
        start = target.parameters(Principled.from_fit(subject.fit["bsdf"], subject.fit["values"]))
        exported = fit_target(target, start, fit_samples.from_brdf(subject.material))
        shown = (mf.read_bsdf(path), ExportedBRDF(target, exported))
        columns.append(np.vstack([mf.render_ball(one, size=160) for one in shown]))
    images.write_image(given.output, np.hstack(columns))


if __name__ == "__main__":
    main()
