"""One world and one population: a swarm on a bus is trial 0 of the experiment with the same parameters."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from host_tools.swarm.swarms import record
from host_tools.swarm.test_swarm_faults import MIX
from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm.settings import SwarmSettings
from trials import images_by_message

COMMON: dict[str, Any] = {"robots": 6, "flawed": "50%", "steps": 250, "filter_period": 20, "seed": 7}
CASES: dict[str, dict[str, Any]] = {
    "fully connected": {},
    "no filter": {"filter": "none"},
    "always, drifting": {"activation": "always", "drift": "wiener", "drift_diffusion": 1e-3},
    "dynamic": {"topology": "dynamic"},
    "dynamic, late, rare broadcasts": {"topology": "dynamic", "latency": 1, "comms_period": 5},
    "dynamic, rare observations": {"topology": "dynamic", "observation_period": 3, "memory": 64},
    "two sensors' accuracies": {"topology": "dynamic", "white_offset": -0.1, "filter": "asdf-minus"},
    "graph": {"topology": "graph", "graph": "0 1; 1 2; 2 > 3; 4 > 0"},
    "late": {"latency": 1},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("firmware", ["native", "mirror"])
def test_a_swarm_on_a_bus_is_trial_0_to_the_bit(case: str, firmware: str) -> None:
    """Through frames on a bus, by the engine in C where it can, and message by message in Python."""
    parameters = COMMON | CASES[case] | {"firmware": firmware}
    experiment = Experiment(**parameters, trials=1)
    run, _ = record(SwarmSettings(**parameters))
    images = [node.robot.save() for node in run.nodes if isinstance(node.robot, FixedPointRobot)]
    assert images == images_by_message(experiment, 0)
    if native.can_run(experiment):
        assert images == native.run(experiment, 0, 1).images()


FAULTS = " ".join(f"--fault {fault}" for fault in MIX)


@pytest.mark.parametrize(
    "options",
    [
        "",
        "--topology dynamic",
        f"--set latency=1 {FAULTS}",
        f"--set comms-period=3 {FAULTS}",
        f"--topology dynamic --firmware mirror {FAULTS}",
    ],
)
def test_a_run_without_a_bus_has_the_files_of_a_run_over_one(options: str, tmp_path: Path) -> None:
    """Time stamps that the user asks for make the tool use python-can's virtual bus."""
    common = (
        f"swarm --robots 6 --steps 120 --filter-period 21 --set telemetry-period=7 --quiet {options}".split()
    )
    over_a_bus = ["--bus-kwargs", "preserve_timestamps=True"]
    for name, more in (("without", []), ("with", over_a_bus)):
        assert main([*common, *more, "--log", str(tmp_path / f"{name}.log")]) == 0
    for suffix in (".log", ".log.events"):
        without, over = (tmp_path / f"{name}{suffix}" for name in ("without", "with"))
        assert without.read_bytes() == over.read_bytes()
    results = [json.loads((tmp_path / f"{name}.log.json").read_text()) for name in ("without", "with")]
    assert results[0] == results[1]
    assert main(["replay", str(tmp_path / "without.log")]) == 0
