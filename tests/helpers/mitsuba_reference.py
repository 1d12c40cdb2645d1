"""Mitsuba's `measured` plugin as a reference, in a scalar variant: it needs no LLVM."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

from manifold.render.measured_plugin import load_bsdf


def measured(
    path: Path, wi: np.ndarray, wo: np.ndarray, wavelengths_nm: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """f_cos and pdf of a file for K direction pairs.

    Args:
        path: a spectral file, or with `wavelengths_nm=None` an RGB file.
        wi, wo: unit vectors (K, 3).
        wavelengths_nm: four wavelengths per pair, (K, 4).
    Returns:
        f_cos (K, 4) or (K, 3) in 1/sr, and the pdf (K,) in 1/sr.
    """
    mi.set_variant("scalar_rgb" if wavelengths_nm is None else "scalar_spectral")
    bsdf = load_bsdf(mi, {"type": "measured", "filename": str(path)})
    context = mi.BSDFContext()
    interaction = mi.SurfaceInteraction3f()
    f_cos = np.empty((len(wi), 3 if wavelengths_nm is None else 4))
    pdf = np.empty(len(wi))
    for k in range(len(wi)):
        interaction.wi = mi.Vector3f(*wi[k].tolist())
        if wavelengths_nm is not None:
            interaction.wavelengths = mi.Spectrum(*wavelengths_nm[k].tolist())
        out = mi.Vector3f(*wo[k].tolist())
        f_cos[k] = bsdf.eval(context, interaction, out)
        pdf[k] = bsdf.pdf(context, interaction, out)
    return f_cos, pdf
