"""Slices of completed BRDFs with bands of uncertainty, beside measured ones and the readings.

    python benchmarks/completed_slices.py FOLDER docs/images/completed-slices.png NAME ...

FOLDER holds `.bsdf` files in RGB. Each material NAME is completed from its values at the geometries of an MA-T12,
with all others as library. Each of these is completed from the rest in the same way, and the band at a direction is as
wide as nine in ten of them need there (split conformal prediction). The share of the measured values in the band is
printed. Shown in docs/explanation/completion.md.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from left_out import Given, complete

import manifold as mf
from manifold.brdf.interface import BRDF
from manifold.core.directions import from_spherical, to_spherical
from manifold.core.records import Array
from manifold.estimate import LibraryAtoms
from manifold.formats import geometry_ma_t12

INCIDENCES_DEG = (15.0, 45.0, 60.0)
ELEVATIONS_DEG = np.linspace(-80.0, 80.0, 321)
SHARE = 0.9  # of materials whose errors the band holds
LEAST = 1e-6  # 1/sr; smaller values count as this


def slices(brdf: BRDF) -> Array:
    """Return the mean of f over the bands, shape (incidences, elevations)."""
    outgoing = from_spherical(np.deg2rad(ELEVATIONS_DEG), np.pi)
    rows = [
        brdf.eval(np.broadcast_to(from_spherical(np.deg2rad(theta), 0.0), outgoing.shape), outgoing)
        for theta in INCIDENCES_DEG
    ]
    return np.stack(rows).mean(axis=-1)


def widths(atoms: LibraryAtoms, materials: dict[str, mf.MeasuredBRDF]) -> Array:
    """Return the factor by which nine in ten materials of the library, each completed from the others, err at most.

    Shape: (incidences, elevations).
    """
    factors = []
    for name in atoms.names:
        completed = complete(atoms, materials[name], name)
        truth, curve = (np.maximum(slices(brdf), LEAST) for brdf in (materials[name], completed))
        factors.append(np.maximum(truth / curve, curve / truth))
    rank = int(np.ceil(SHARE * (len(factors) + 1))) - 1
    return np.sort(factors, axis=0)[min(rank, len(factors) - 1)]


def main() -> None:
    """Draw a row for each material."""
    given = Given.parse(__doc__)
    count = len(given.names)
    figure, axes = plt.subplots(
        count,
        3,
        figsize=(10, 2.6 * count + 0.5),
        sharex=True,
        sharey="row",
        squeeze=False,
        layout="constrained",
    )
    with tempfile.TemporaryDirectory() as temporary:
        library = Path(temporary) / "library.zarr"
        mf.import_files(library, list(given.paths.values()))
        atoms = LibraryAtoms.of_library(mf.Library.open(library))
    materials = {name: mf.MeasuredBRDF(mf.read_bsdf(path)) for name, path in given.paths.items()}
    wi, wo = geometry_ma_t12()
    incidence = np.rad2deg(to_spherical(wi)[0])
    is_opposite = np.sum(wi[:, :2] * wo[:, :2], axis=1) < 0
    elevation = np.where(is_opposite, 1.0, -1.0) * np.rad2deg(to_spherical(wo)[0])
    for row, name in zip(axes, given.names, strict=True):
        others = atoms.without(atoms.names.index(name))
        curves = slices(complete(atoms, materials[name], name))
        truth, factor = slices(materials[name]), widths(others, materials)
        read = materials[name].eval(wi, wo).mean(axis=1)
        for axis, theta, f, measured, width in zip(row, INCIDENCES_DEG, curves, truth, factor, strict=True):
            axis.fill_between(
                ELEVATIONS_DEG,
                f / width,
                f * width,
                color="#0072b2",
                alpha=0.22,
                lw=0,
                label="90 % band",
            )
            axis.plot(ELEVATIONS_DEG, f, color="#0072b2", label="completed")
            axis.plot(ELEVATIONS_DEG, measured, "--", color="black", lw=1.2, label="measured")
            here = np.abs(incidence - theta) < 1.0
            axis.plot(elevation[here], read[here], "o", color="#d55e00", ms=5, label="readings")
            axis.set_yscale("log")
            axis.grid(alpha=0.25, lw=0.5)
            axis.axvline(theta, color="0.75", lw=0.8, zorder=0)
        shown = np.concatenate([curves.ravel(), truth.ravel()])
        row[0].set_ylim(max(shown.min(), shown.max() * 1e-5) / 4.0, shown.max() * 4.0)
        inside = (curves / factor <= truth) & (truth <= curves * factor)
        print(f"{name}: {100.0 * inside.mean():.0f} % of the measured values are in the band", flush=True)
        row[0].set_ylabel(f"{name.replace('_', ' ')}\n$f$ (1/sr)", fontsize=9)
    for axis, theta in zip(axes[0], INCIDENCES_DEG, strict=True):
        axis.set_title(f"incidence {theta:g}°", fontsize=11)
    axes[-1, 1].set_xlabel("outgoing angle (°), mirror side positive")
    axes[-1, 1].set_xticks(np.arange(-60, 61, 30))
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(given.output, dpi=100)


if __name__ == "__main__":
    main()
