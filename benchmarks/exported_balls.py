"""Balls of materials: measured, and as a target of exports draws them, with the ball error under each.

    python benchmarks/exported_balls.py docs/images/exported-balls.png FILE ... [--target gltf]

A file with a fit beside it (`NAME.fit.json`) is not fitted again. Shown in docs/explanation/fits.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
from lit_balls import lit_ball, save

import manifold as mf
from manifold.core.records import Array
from manifold.fit import exporting, fit_samples
from manifold.fit.exports.direct import fit_target
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.fit.exports.targets import TargetBRDF
from manifold.io_rgl import material_name
from manifold.model import brdf_errors
from manifold.registries import TARGETS

SIZE = 200  # pixels across a ball


class ExportedBRDF(TargetBRDF):
    """A target's shading model with the methods of a BRDF."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., 3)."""
        return self.eval(wi, wo) * wo[..., 2:].clip(0.0)


def exported(path: Path, target_name: str) -> ExportedBRDF:
    """Return the target's model with the parameters that an export of the file has."""
    target = TARGETS[target_name]
    fit = path.with_name(path.name.replace("_rgb.bsdf", ".fit.json"))
    subject = exporting.subject_of(fit, path) if fit.exists() else exporting.subject_of(path, None)
    assert subject.material is not None
    start = target.parameters(PrincipledValues.from_fit(subject.fit["bsdf"], subject.fit["values"]))
    return ExportedBRDF(target, fit_target(target, start, fit_samples.from_brdf(subject.material)))


def main() -> None:
    """Draw a column for each file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("output", type=Path)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--target", choices=TARGETS, default="gltf")
    given = parser.parse_args()
    count = len(given.files)
    figure, axes = plt.subplots(2, count, figsize=(2.2 * count, 4.9), squeeze=False, layout="constrained")
    for (above, below), path in zip(axes.T, given.files, strict=True):
        measured, made = mf.MeasuredBRDF(mf.read_bsdf(path)), exported(path, given.target)
        error = brdf_errors(measured, made).ball
        print(f"{material_name(path)}: {error:.2f}", flush=True)
        above.set_title(material_name(path).replace("_", " "), fontsize=10)
        below.text(0.5, -0.02, f"{error:.1f}", transform=below.transAxes, ha="center", va="top", fontsize=11)
        for axis, brdf in ((above, measured), (below, made)):
            axis.imshow(lit_ball(brdf, SIZE))
            axis.axis("off")
    for axis, label in zip(axes[:, 0], ("measured", f"fitted for {given.target}"), strict=True):
        axis.text(-0.04, 0.5, label, transform=axis.transAxes, rotation=90, ha="right", va="center")
    save(figure, given.output)


if __name__ == "__main__":
    main()
