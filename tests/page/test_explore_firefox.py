"""The page in Firefox, driven by WebDriver BiDi: the same picture, mouse and keys. Skipped where that is missing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import REPOSITORY

from manifold.colour import ball_colours, lights
from manifold.colour.conversion import decode_srgb, srgb_to_xyz


def command() -> tuple[list[str], dict[str, str]]:
    """What runs a script of Firefox, and its environment; or a skipped test."""
    modules = Path(os.environ.get("MANIFOLD_NODE_MODULES", REPOSITORY / ".venv" / "node_modules"))
    firefox = shutil.which("firefox") or shutil.which("firefox-esr")
    if firefox is None:
        pytest.skip("no Firefox: apt-get install firefox-esr")
    if not (modules / "puppeteer-core").is_dir() or shutil.which("node") is None:
        pytest.skip(
            "no puppeteer-core: npm install --prefix .venv puppeteer-core, or set MANIFOLD_NODE_MODULES"
        )
    display = [] if os.environ.get("DISPLAY") else ["xvfb-run", "-a"]
    if display and shutil.which("xvfb-run") is None:
        pytest.skip("Firefox has no WebGL without a display: apt-get install xvfb")
    script = Path(__file__).with_name("firefox.cjs")
    return [*display, "node", str(script)], os.environ | {"NODE_PATH": str(modules), "FIREFOX": firefox}


def test_firefox_shows_the_same_and_takes_mouse_and_keys(request):
    start, environment = command()
    model, address = map(request.getfixturevalue, ("model", "address"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ball_colours, "environment", lambda: lights.environment("studio"))
        ball = ball_colours.ball.__wrapped__(rings=72, spokes=48)
    asked = [*start, address, json.dumps(ball.places.tolist())]
    run = subprocess.run(asked, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    if "WebGL2" in found["problem"]:
        pytest.skip(f"Firefox cannot draw here: {found['problem']}")
    assert found["errors"] == []
    shown = srgb_to_xyz(decode_srgb(np.array(found["ball"]) / 255.0))
    expected = ball.xyz(model.predict(found["dragged"]["x"]).eval(ball.wi, ball.wo), model.bands)
    assert ball_colours.delta_e(shown, expected) < 1.0  # as in Chromium
    assert found["pressed"]["at"] in model.names
    assert "copper" in found["searched"]["at"]
    assert found["scrubbed"]["path"]["t"] == pytest.approx(0.01)
    assert found["left"]["path"] is None
    assert found["reloaded"]["x"] == pytest.approx(found["left"]["x"], abs=1e-4)
    assert found["slider"] == "0"
    assert found["red"][0] > 3 * found["red"][2]
