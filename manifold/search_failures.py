"""Failure modes of the searches for latents: starts, stopping, ambiguities, precision."""

from __future__ import annotations

from manifold.stability import Mode

MODES: tuple[Mode, ...] = ()
