"""One world and one population: a swarm on a bus is trial 0 of the experiment with the same parameters."""

from __future__ import annotations

from typing import Any

import pytest

from host_tools.swarm.swarms import record
from mcp_asdf.robot import FixedPointRobot
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
