"""The test bench of a verification, which brings a controller into the situations that phases are about."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Sequence

import can

from mcp_asdf.mirror import State
from mcp_asdf.robot import MAX_ID, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import TRANSFER_ID_MODULUS, Action
from mcp_asdf_tools.bus.frames import Command, Estimate, encode_estimate
from mcp_asdf_tools.crosscheck.crafted_rounds import NeighbourEstimate, RobotState
from mcp_asdf_tools.radio.controller_link import BenchOptions, ControllerLink
from mcp_asdf_tools.radio.neighbourhood import RadioSettings, create_neighbours
from mcp_asdf_tools.robots.lockstep import DRIVER_ID

BURST = 16
"""Ticks in a burst, which settles only the last. A controller must be able to take as many commands at the
speed of the bus."""


class Bench(ControllerLink):
    """Link to a controller with what phases need: ticks and rounds with chosen estimates, and quick waits.

    A round lasts from one broadcast of the controller to the next.

    Attributes:
        neighbours: Emulated robots around the controller, for phases among neighbours.
        rng: Random numbers, the same in every run with this seed.
        activity: What the phase does at present. It is part of the report of a difference.
        not_exercised: Cases that the phases could not bring about, for the verdict.
    """

    def __init__(self, settings: RadioSettings, options: BenchOptions) -> None:
        """Start the model and the neighbours. Nothing is sent to the controller yet.

        ``activity`` is what a phase does at present, for the report of a difference, and ``not_exercised``
        are the cases that phases could not bring about.
        """
        super().__init__(settings, options)
        self.neighbours = create_neighbours(settings)
        self.rng = random.Random(settings.swarm.seed)
        self.activity = ""
        self.not_exercised: list[str] = []
        self._estimate_count_by_sender: Counter[int] = Counter()

    # --- Estimates and observations for the controller ---

    @property
    def other_ids(self) -> list[int]:
        """All ids that a sender can have but the controller's own, in ascending order."""
        return [robot for robot in range(MAX_ID + 1) if robot != self.setup.id]

    @property
    def model_state(self) -> State:
        """State of the model's robot, which the controller must have, too. It changes as ticks pass."""
        return self.model_robot.s

    @property
    def robot_state(self) -> RobotState:
        """A copy of t, n, x_hat and the table of the test, for which the estimates of a round are crafted."""
        state = self.model_state
        table = None
        if self.config.filter is Filter.ADAPTIVE:  # the only filter with a test of this kind
            table = self.config.table
        return RobotState(state.t, state.n, state.x_hat, table)

    def draw_observation(self) -> Observation:
        """Draw a colour such that the share of black ones stays near 3/5, but not exactly.

        With a share above 1/2, b_hat can be re-estimated on both sides of 1/2.
        """
        state = self.model_state
        is_black = 5 * state.n < 3 * state.t  # as the share n / t is below 3/5
        # In one of five cases the other colour moves the share away from 3/5.
        if self.rng.random() >= 0.8:
            is_black = not is_black
        return Observation(is_black)

    def encode_estimates(
        self, estimates: Sequence[NeighbourEstimate], senders: Sequence[int] | None = None
    ) -> list[can.Message]:
        """Encode these estimates, and return their frames in the same order.

        ``senders`` are as many ids as there are estimates, and may name a robot several times; by default
        different robots are drawn. Every sender numbers its frames by a transfer_id that goes on from one
        call to the next.
        """
        if senders is None:
            senders = self.rng.sample(self.other_ids, len(estimates))
        frames = []
        for sender, (x_hat, alpha) in zip(senders, estimates, strict=True):
            transfer_id = self._estimate_count_by_sender[sender] % TRANSFER_ID_MODULUS
            self._estimate_count_by_sender[sender] += 1
            estimate = Estimate(sender, x_hat, alpha, transfer_id)
            frames.append(encode_estimate(estimate, self.settings.subjects.estimates))
        return frames

    def make_command(self, action: Action) -> Command:
        """Return a command for this action of the controller in the present tick, without sending it.

        Its transfer_id is drawn at random.
        """
        return Command(
            DRIVER_ID, self.lockstep.tick, self.setup.id, action, self.rng.randrange(TRANSFER_ID_MODULUS)
        )

    # --- Ticks ---

    def play_tick(self, observation: Observation | None = None, frames: Sequence[can.Message] = ()) -> None:
        """Run a tick with this observation, or none, in which the controller receives these frames.

        At the end the controller's frames are compared with the model's.
        """
        self.observe(observation)
        self.send(frames)
        self.settle_and_compare()

    def play_tick_among_neighbours(self) -> None:
        """Run a tick in which the controller and the emulated neighbours receive each other's frames.

        At the end the controller's frames are compared with the model's.
        """
        observation_by_robot = self.neighbours.begin_tick()
        self.observe(observation_by_robot[self.setup.id])
        controller_frames = list(self._received_frames)  # the last comparison took those before this tick
        neighbour_frames = self.neighbours.finish_tick(controller_frames)
        self.send(neighbour_frames)
        self.settle_and_compare()

    def skip_ticks(
        self, ticks: int, choose_observation: Callable[[], Observation | None] = lambda: None
    ) -> None:
        """Let ticks without messages pass quickly, in bursts of up to 16.

        A tick within a burst gets an observe command alone, and ends when the next one comes. Only the last
        tick of a burst ends with a settle command, for whose answer the bench waits. ``choose_observation``
        returns the observation of each tick; by default there is none.
        """
        remaining_ticks = ticks
        while remaining_ticks > 0:
            burst_length = min(remaining_ticks, BURST)
            for _ in range(burst_length - 1):
                self._send_observe_command(choose_observation())
                self.skip_settle()
            self.play_tick(choose_observation())
            remaining_ticks -= burst_length

    # --- Rounds ---

    def play_round(
        self,
        activity: str,
        estimates: Sequence[NeighbourEstimate],
        senders: Sequence[int] | None = None,
    ) -> None:
        """Wait for a round without a test, and run it with these estimates.

        ``senders`` are the ids of their senders, as for ``encode_estimates``. A difference in this round is
        reported with ``activity``.
        """
        self.play_round_of_frames(activity, self.encode_estimates(estimates, senders))

    def play_round_of_frames(self, activity: str, frames: Sequence[can.Message]) -> None:
        """Wait for a round without a test, and run it with these frames.

        A difference in this round is reported with ``activity``.
        """
        self.skip_to_round()
        self.wait_for_round_without_test()
        self.activity = activity
        self._run_round(frames)

    def play_test_round(
        self,
        activity: str,
        estimates: Sequence[NeighbourEstimate],
        senders: Sequence[int] | None = None,
    ) -> None:
        """Wait for the round at whose end the filter tests next, and run it with these estimates.

        The controller observes nothing while it waits. ``senders`` and ``activity`` are as in ``play_round``.
        """
        self.skip_to_test_round()
        self.activity = activity
        self._run_round(self.encode_estimates(estimates, senders))

    def _run_round(self, frames: Sequence[can.Message]) -> None:
        """Run a round without observations, which begins now.

        The first half of the frames is sent in the first tick, and the second half in the last tick. If the
        round has a single tick, all frames are sent in it.
        """
        ticks_in_round = self.setup.comms_period
        if ticks_in_round == 1:
            self.play_tick(None, frames)
            return
        half = len(frames) // 2
        self.play_tick(None, frames[:half])
        self.skip_ticks(ticks_in_round - 2)
        self.play_tick(None, frames[half:])

    def skip_to_round(self) -> None:
        """Let ticks pass until a round begins, as at every multiple of its length; none if one begins now."""
        ticks_in_round = self.setup.comms_period
        ticks_of_this_round = self.model_node.ticks % ticks_in_round
        if ticks_of_this_round > 0:
            self.skip_ticks(ticks_in_round - ticks_of_this_round)

    def skip_to_test_round(
        self,
        choose_observation: Callable[[], Observation | None] = lambda: None,
        rounds_before: int = 0,
    ) -> None:
        """Let ticks pass until the round begins at whose end the filter tests next.

        Stops ``rounds_before`` rounds earlier. ``choose_observation`` returns the observation of each tick;
        by default there is none.
        """
        filter_period, ticks_in_round = self.setup.filter_period, self.setup.comms_period
        # The filter tests at every multiple of its period in ticks. The round of the test begins one round
        # before that.
        tick_to_stop_at = filter_period - (1 + rounds_before) * ticks_in_round
        present_tick = self.model_node.ticks % filter_period
        # Modulo the period: if that tick has passed, the one in the next period is waited for.
        missing_ticks = (tick_to_stop_at - present_tick) % filter_period
        self.skip_ticks(missing_ticks, choose_observation)

    def wait_for_round_without_test(self, rounds: int = 1) -> None:
        """Let rounds pass until the controller's filter has no test in the next ``rounds`` rounds.

        None passes if they have no test anyway, if a round is under way, if the filter is off, or if it
        tests in every round, which cannot be avoided.
        """
        ticks_in_round, filter_period = self.setup.comms_period, self.setup.filter_period
        has_no_test = self.config.filter is Filter.OFF
        has_test_in_every_round = filter_period == ticks_in_round
        is_within_round = self.model_node.ticks % ticks_in_round != 0
        if has_no_test or has_test_in_every_round or is_within_round:
            return
        ticks_to_test = filter_period - self.model_node.ticks % filter_period
        if ticks_to_test <= rounds * ticks_in_round:
            self.skip_ticks(ticks_to_test)
