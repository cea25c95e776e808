"""The test bench of a verification, which brings a controller into the situations that phases are about."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import can

from mcp_asdf.robot import MAX_ID, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import TRANSFER_IDS, Action
from mcp_asdf_tools.bus.frames import Command, Estimate, encode_estimate
from mcp_asdf_tools.crosscheck.crafted_rounds import NeighbourEstimate, RobotState
from mcp_asdf_tools.radio.controller_link import BenchOptions, ControllerLink
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings
from mcp_asdf_tools.robots.lockstep import DRIVER_ID

BURST = 16
"""Ticks in a row of which only the last is settled. A controller must be able to take as many commands at the
speed of the bus."""


class Bench(ControllerLink):
    """Link to a controller with what phases need: ticks and rounds with chosen estimates, and quick waits.

    A round lasts from one broadcast of the controller to the next.

    Attributes:
        neighbours: Emulated robots around the controller, for phases among neighbours.
        rng: Random numbers, the same in every run with this seed.
        activity: What the phase does at present, for the report of a difference.
        not_exercised: Cases that the phases could not bring about, for the verdict.
    """

    def __init__(self, settings: RadioSettings, options: BenchOptions) -> None:
        """Start the model and the neighbours. Nothing is sent to the controller yet."""
        super().__init__(settings, options)
        self.neighbours = Neighbourhood(settings)
        self.rng = random.Random(settings.swarm.seed)
        self.activity = ""
        self.not_exercised: list[str] = []
        self._estimates_by_sender: Counter[int] = Counter()

    # --- Estimates and observations for the controller ---

    @property
    def other_ids(self) -> list[int]:
        """All ids that a sender can have but the controller's own."""
        return [robot for robot in range(MAX_ID + 1) if robot != self.setup.id]

    @property
    def robot_state(self) -> RobotState:
        """The controller's present state, for which the estimates of a round are crafted."""
        state = self.firmware.s
        table = self.config.table if self.config.filter is Filter.ADAPTIVE else None
        return RobotState(state.t, state.n, state.x_hat, table)

    def draw_observation(self) -> Observation:
        """Draw a colour such that the share of black ones stays near 3/5, but not exactly.

        With a share above 1/2, b_hat can be re-estimated on both sides of 1/2.
        """
        state = self.firmware.s
        is_black_share_low = 5 * state.n < 3 * state.t
        # In one of five cases the colour moves the share away from 3/5.
        is_usual = self.rng.random() < 0.8
        is_black = is_black_share_low if is_usual else not is_black_share_low
        return Observation(is_black)

    def encode_estimates(
        self, estimates: dict[int, NeighbourEstimate] | Iterable[tuple[int, NeighbourEstimate]]
    ) -> list[can.Message]:
        """Return a frame for each of these estimates, in order.

        They are given by sender or as pairs of sender and estimate; pairs may name a sender several times.
        Every sender numbers its frames by a transfer_id that goes on from one call to the next.
        """
        pairs = estimates.items() if isinstance(estimates, dict) else estimates
        return [self._encode_estimate(sender, x_hat, alpha) for sender, (x_hat, alpha) in pairs]

    def _encode_estimate(self, sender: int, x_hat: int, alpha: int) -> can.Message:
        """Return the frame of an estimate with the sender's next transfer_id."""
        transfer_id = self._estimates_by_sender[sender] % TRANSFER_IDS
        self._estimates_by_sender[sender] += 1
        estimate = Estimate(sender, x_hat, alpha, transfer_id)
        return encode_estimate(estimate, self.settings.subjects.estimates)

    def make_command(self, action: Action) -> Command:
        """Return the command for this action of the controller in the present tick. Nothing is sent."""
        return Command(DRIVER_ID, self.lockstep.tick, self.setup.id, action, self.rng.randrange(TRANSFER_IDS))

    # --- Ticks ---

    def play_tick(self, observation: Observation | None = None, frames: Sequence[can.Message] = ()) -> None:
        """Run a tick with this observation, or none, in which the controller receives these frames."""
        self.observe(observation)
        self.send(frames)
        self.settle()

    def play_tick_among_neighbours(self) -> None:
        """Run a tick in which the controller and the emulated neighbours receive each other's frames."""
        self.observe(self.neighbours.begin())
        self.send(self.neighbours.finish(list(self._received)))
        self.settle()

    def skip_ticks(self, ticks: int, observe: Callable[[], Observation | None] = lambda: None) -> None:
        """Let ticks without messages pass quickly, in bursts of which only the last tick is settled.

        ``observe`` returns the observation of each tick; by default there is none.
        """
        while ticks > 0:
            burst = min(ticks, BURST)
            for _ in range(burst - 1):
                self._command_observation(observe())
                self.leave_open()  # without a settle, so that the next observation ends the tick
            self.play_tick(observe())
            ticks -= burst

    # --- Rounds ---

    def play_round(self, *estimates: NeighbourEstimate, senders: Sequence[int] | None = None) -> None:
        """Run a round in which the controller receives these estimates.

        They come from ``senders``, as many as estimates; by default from random ones.
        """
        if senders is None:
            senders = self.rng.sample(self.other_ids, len(estimates))
        self.play_round_of_frames(self.encode_estimates(dict(zip(senders, estimates, strict=True))))

    def play_round_of_frames(self, frames: Sequence[can.Message]) -> None:
        """Wait for the next round, and run it without observations.

        Half of these frames come in its first tick, the others in its last.
        """
        period = self.setup.comms_period
        self.skip_to_round()
        if period == 1:
            self.play_tick(None, frames)
            return
        half = len(frames) // 2
        self.play_tick(None, frames[:half])
        self.skip_ticks(period - 2)
        self.play_tick(None, frames[half:])

    def skip_to_round(self) -> None:
        """Let ticks pass until a round begins, as at every multiple of its length; none if one begins now."""
        missing_ticks = -self.model.ticks % self.setup.comms_period
        self.skip_ticks(missing_ticks)

    def skip_to_test_round(
        self, observe: Callable[[], Observation | None] = lambda: None, rounds_before: int = 0
    ) -> None:
        """Let ticks pass until the round begins at whose end the filter tests next.

        Stops ``rounds_before`` rounds earlier. ``observe`` returns the observation of each tick.
        """
        period = self.setup.filter_period
        # The filter tests at every multiple of its period in ticks. The round of the test begins one round
        # before that.
        tick_in_period = period - (1 + rounds_before) * self.setup.comms_period
        missing_ticks = (tick_in_period - self.model.ticks) % period
        self.skip_ticks(missing_ticks, observe)

    def begin_activity_without_test(self, activity: str, rounds: int = 1) -> None:
        """Wait until the controller's filter has no test in the next ``rounds`` rounds, and set ``activity``.

        ``activity`` says what the phase does from now on, and is part of the report of a difference. While
        the wait lasts, rounds without messages are played. There is no wait if the next rounds have no test
        anyway, if the filter is off, or if it tests in every round, which cannot be avoided.
        """
        if self.config.filter is not Filter.OFF and self.config.filter_period > 1:
            # From the furthest round to the next one: a round that is played brings the test one closer.
            for distance in range(rounds, 0, -1):
                ticks_at_its_end = self.model.ticks + distance * self.setup.comms_period
                if ticks_at_its_end % self.setup.filter_period == 0:
                    self.play_round()
        self.activity = activity
