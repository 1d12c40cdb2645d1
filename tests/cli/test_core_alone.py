"""What works with the required packages alone, and what names the extra that it needs."""

from __future__ import annotations

import pytest
from helpers.one_process import run_together
from helpers.small_library import NAMES, small_library

from manifold.core.extras import EXTRAS

READINGS = "theta_i,phi_i,theta_o,phi_o,R,G,B\n45,180,0,0,0.2,0.1,0.05\n45,180,30,0,0.22,0.12,0.06\n"
WORKS = {
    "import": ["import", "files"],
    "info": ["info", "library.zarr"],
    "info of a file": ["info", "files/syn_satin_gold_rgb.bsdf"],
    "info --system": ["info", "--system"],
    "embed": ["embed"],
    "predict": ["predict", "0.1,0.1", "-o", "made.bsdf"],
    "locate": ["locate", "files/syn_satin_gold_rgb.bsdf"],
    "reconstruct": ["reconstruct", "files/syn_satin_gold_rgb.bsdf", "--without", "syn_satin_gold"],
    "complete": ["complete", "readings.csv", "--unit", "brdf", "-o", "completed.bsdf"],
    "convert": ["convert", "readings.csv", "-o", "readings.astm"],
    "find": ["find", "--lab", "50,20,10"],
    "report": ["report"],
    "fit": ["fit", "made.bsdf", "--free", "roughness"],
    "export --target shader": ["export", "made.bsdf", "--target", "shader", "-o", "shader"],
    "explore -o": ["explore", "-o", "map.html"],
}
NEEDS = {
    "map": (["map"], "plots"),
    "slices": (["slices", "made.bsdf"], "plots"),
    "report --picture": (["report", "--picture"], "plots"),
    "render": (["render", "made.bsdf"], "render"),
    "fetch": (["fetch", "cardboard", "-o", "rgl"], "fetch"),
    "explore": (["explore", "--no-browser"], "page"),
    "predict --scheduler": (
        ["predict", "--from", "places.csv", "--scheduler", "tcp://127.0.0.1:1"],
        "cluster",
    ),
}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Status, stdout and stderr of every command, in one process without the packages of the extras."""
    folder = tmp_path_factory.mktemp("core")
    small_library(folder, names=NAMES[2:], library=folder / "other.zarr")
    (folder / "readings.csv").write_text(READINGS)
    (folder / "places.csv").write_text("x,y\n0,0\n0.1,0.1\n")
    commands = WORKS | {name: words for name, (words, _) in NEEDS.items()}
    missing = sorted({module for modules in EXTRAS.values() for module in modules})
    return run_together(missing, commands, folder)


@pytest.mark.parametrize("name", WORKS)
def test_the_main_job_works_with_the_required_packages_alone(outcomes, name):
    status, _, err = outcomes[name]
    assert status == 0, err


@pytest.mark.parametrize("name", NEEDS)
def test_a_missing_package_is_one_line_that_names_its_extra(outcomes, name):
    status, _, err = outcomes[name]
    assert status == 1
    (line,) = err.splitlines()
    assert f"brdf-manifold[{NEEDS[name][1]}]" in line


def test_the_system_information_says_which_packages_are_missing(outcomes):
    assert "extra plots" in outcomes["info --system"][1]
