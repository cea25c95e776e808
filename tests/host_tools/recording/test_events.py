"""Files of events give back what was recorded, older versions are read, and malformed lines are named."""

from __future__ import annotations

import gzip
import json
import math
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from events_files import events_file, read_entries
from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import events as events_module
from mcp_asdf_tools.recording.events import (
    EventsHeader,
    EventsReader,
    InjectedFrame,
    RobotEvents,
    events_path,
)
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.replay import ReplayVerdict, verify
from mcp_asdf_tools.tables.thresholds import generate
from messages import FRAMES
from wire import setup_of_robot


def header_of(*robot_ids: int) -> EventsHeader:
    """Return the header of a file with events of some robots, which are set up alike."""
    robots = [setup_of_robot(robot_id) for robot_id in robot_ids]
    return EventsHeader(robots, seed=5, frames=FrameFormat())


FIRST_LINE_OF_ROBOTS_0_AND_7 = header_of(0, 7).to_line()
"""The header, with a line break, of a file with events of the robots 0 and 7."""


# --- What is read is what was written -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("log", "expected_path"),
    [("run.log", "run.log.events"), ("run.log.part", "run.log.events.part"), ("a/b", "a/b.events")],
)
def test_events_stand_beside_their_log(log: str, expected_path: str) -> None:
    """Events say what each robot of a recorded run met; they have a file beside the frame log.

    The events of run.log are in run.log.events, for example.
    """
    assert events_path(log) == Path(expected_path)


def test_a_file_of_events_given_as_a_log_of_frames_is_refused() -> None:
    """A user who mixes up the two files of a recording is told which one to give."""
    with pytest.raises(UsageError, match=r"run\.log\.events is what happened to the robots of a log; give"):
        events_path("run.log.events")


def test_the_header_of_an_events_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    """The header says how each robot was set up, so that replay can build it again.

    The four robots differ in firmware, estimated accuracy, filter, periods, memory and t-table. Numbers
    such as 0.1 + 0.2 and 2**-20 have many digits, and none is lost.
    """
    robots = (
        setup_of_robot(0, firmware="native", b_hat=0.1 + 0.2),
        setup_of_robot(7, firmware="mirror", filter=Filter.ALWAYS, comms_period=5, memory=64),
        setup_of_robot(127, firmware="reference", b_hat=0.95, filter=Filter.OFF, filter_period=3, table=None),
        setup_of_robot(3, b_hat=2.0**-20, table=generate(omega=Decimal("0.123456789"), q=2)),
    )
    header = EventsHeader(
        robots,
        seed=5,
        frames=FrameFormat(subject=17, priority=2),
        parameters={"fill_ratio": 0.55, "faults": ["loss=0.5"]},
    )
    with events_file(tmp_path / "x", header):
        pass  # the file has the header and no events
    with EventsReader(tmp_path / "x") as reader:
        assert reader.header == header


def test_a_header_with_a_number_that_json_lacks_is_refused() -> None:
    """JSON has no "not a number" (nan), so other programs could not read the file."""
    header = EventsHeader([], seed=None, frames=FrameFormat(), parameters={"fill_ratio": math.nan})
    with pytest.raises(ValueError, match="not JSON compliant"):
        header.to_line()


BLACK, WHITE, NO_OBSERVATION, END_OF_TICK = 1, 0, 2, 3
"""Numbers by which a file of events stands for what a robot does in a tick."""


def test_observations_and_received_estimates_are_read_as_they_were_recorded(tmp_path: Path) -> None:
    """Robot 7 sees a black tile, receives two estimates, and sees a white tile in its next tick.

    The file has an entry for each of the two ticks, with what happened in it.
    """
    largest_estimate = [3, 2**23, 2**32 - 1]  # sender, x_hat and alpha
    smallest_estimate = [127, 0, 0]
    with events_file(tmp_path / "x", header_of(7)) as writer:
        recorder = writer.recorders[7]
        recorder.record_observation(Observation.BLACK)
        recorder.record_estimates([largest_estimate, smallest_estimate])
        recorder.record_settle()  # ends the tick
        recorder.record_observation(Observation.WHITE)
        recorder.record_settle()

    assert read_entries(tmp_path / "x") == [
        RobotEvents(7, [BLACK, largest_estimate, smallest_estimate, END_OF_TICK]),
        RobotEvents(7, [WHITE, END_OF_TICK]),
    ]


def test_injected_faults_are_read_as_they_were_recorded(tmp_path: Path) -> None:
    """Robot 7 observes nothing, sends false values, misses a broadcast and starts again, all in one entry."""
    x_hat, alpha = 5, 2**31
    with events_file(tmp_path / "x", header_of(7)) as writer:
        recorder = writer.recorders[7]
        recorder.record_observation(None)
        recorder.record_false_values(x_hat, alpha)
        recorder.record_silence()
        recorder.record_restart()

    assert read_entries(tmp_path / "x") == [
        RobotEvents(7, [NO_OBSERVATION, [x_hat, alpha], "silent", "restart"])
    ]


def test_frames_injected_by_a_fault_are_recorded_as_candump_writes_them(tmp_path: Path) -> None:
    """FRAMES has a frame of each of four kinds, by the text that candump writes for it: "042#"."""
    with events_file(tmp_path / "x", header_of(7)) as writer:
        for frame in FRAMES.values():
            writer.record_injected_frame(frame)

    expected_entries = [InjectedFrame(text_of_candump) for text_of_candump in FRAMES]
    assert read_entries(tmp_path / "x") == expected_entries


def test_a_flood_of_estimates_is_written_in_several_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line is written once it has more than its maximum of events, here four, so memory does not grow.

    Robot 7 receives three estimates four times. After the second and the fourth time it has six.
    """
    monkeypatch.setattr(events_module, "_MAX_EVENTS_PER_LINE", 4)
    three_estimates = [[3, 1, 2]] * 3  # each with sender, x_hat and alpha
    with events_file(tmp_path / "x", header_of(7)) as writer:
        for _ in range(4):
            writer.recorders[7].record_estimates(three_estimates)

    line_of_six = RobotEvents(7, [*three_estimates, *three_estimates])
    assert read_entries(tmp_path / "x") == [line_of_six, line_of_six]


# --- Earlier versions -----------------------------------------------------------------------------------


def test_a_mask_in_a_file_of_version_3_is_read_as_the_last_estimates_of_its_senders(tmp_path: Path) -> None:
    """Such files do not repeat an estimate: the mask "9" (bits 0 and 3) stands for robots 0 and 3.

    Robot 7 received both, a list of sender, x_hat and alpha each; then robot 0 received the same two. Before,
    each observed black (1), and at last it ended the tick (3).
    """
    first_line_of_version_3 = FIRST_LINE_OF_ROBOTS_0_AND_7.replace('"version": 5', '"version": 3')
    line_of_robot_7 = "[7,1,[3,9,8],[0,1,2],3]"
    line_of_robot_0 = '[0,1,"9",3]'  # the estimates are received in the order of their senders
    (tmp_path / "x").write_text(f"{first_line_of_version_3}{line_of_robot_7}\n{line_of_robot_0}\n")

    assert read_entries(tmp_path / "x") == [
        RobotEvents(7, [BLACK, [3, 9, 8], [0, 1, 2], END_OF_TICK]),
        RobotEvents(0, [BLACK, [0, 1, 2], [3, 9, 8], END_OF_TICK]),
    ]


def test_a_log_that_an_earlier_program_wrote_is_replayed_without_a_difference() -> None:
    """Its events are in version 3 of the format. The verdict has the number of frames of each kind.

    The log has 66 frames. A fault of that run gave five broadcasts false values, and sent two frames under a
    robot's id. The other 51 broadcasts come out again, and eight frames are heartbeats.
    """
    log = Path(__file__).parent / "version_3.log"
    with EventsReader(events_path(log)) as reader:
        verdict = verify(read_log(log), reader)
    assert verdict == ReplayVerdict(difference=None, reproduced=51, falsified=5, foreign=2, other=8)


def test_events_of_version_4_are_read(tmp_path: Path) -> None:
    """The present version is 5. In the only line robot 7 observes black (1) and ends the tick (3)."""
    first_line_of_version_4 = FIRST_LINE_OF_ROBOTS_0_AND_7.replace('"version": 5', '"version": 4')
    (tmp_path / "x").write_text(f"{first_line_of_version_4}[7,1,3]\n")
    assert read_entries(tmp_path / "x") == [RobotEvents(7, [BLACK, END_OF_TICK])]


@pytest.mark.parametrize("version", [3, 4])
def test_robots_with_an_earlier_robust_filter_are_refused_by_their_ids(version: int, tmp_path: Path) -> None:
    """The earlier filter computed other numbers, so a replay would report differences that are no faults.

    The robots 3, 4 and 7 of the file have the robust filter, and robot 0 has another one.
    """
    robots = [
        setup_of_robot(0, filter=Filter.ALWAYS),
        setup_of_robot(3, filter=Filter.ROBUST),
        setup_of_robot(4, filter=Filter.ROBUST),
        setup_of_robot(7, filter=Filter.ROBUST),
    ]
    first_line = EventsHeader(robots, seed=5, frames=FrameFormat()).to_line()
    (tmp_path / "x").write_text(first_line.replace('"version": 5', f'"version": {version}'))
    message = (
        r"x, line 1: robots 3-4\+7 have the robust filter of an earlier mcp-asdf, which cannot be repeated "
        "here; replay the log with the mcp-asdf that wrote it, or record the run again"
    )

    with pytest.raises(UsageError, match=message):
        EventsReader(tmp_path / "x")


# --- Files that were cut or damaged -------------------------------------------------------------------


def test_compressed_events_that_were_cut_are_refused_with_the_line(swarm_log: Path, tmp_path: Path) -> None:
    """The name of a file that is only half there must end in ``.part``; reading any other one is an error."""
    data = events_path(swarm_log).read_bytes()
    first_half = data[: len(data) // 2]
    (tmp_path / "x").write_bytes(first_half)
    with pytest.raises(UsageError, match=r"x, line \d+: the file ends here, in the middle; was it cut\?"):
        read_entries(tmp_path / "x")


def test_compressed_events_with_a_wrong_byte_are_refused(swarm_log: Path, tmp_path: Path) -> None:
    """A byte in the middle of the file is inverted. The error names the file and the line."""
    data = bytearray(events_path(swarm_log).read_bytes())
    middle = len(data) // 2
    data[middle] ^= 0b11111111
    (tmp_path / "x").write_bytes(data)

    with pytest.raises(UsageError, match=r"x, line \d+: "):
        read_entries(tmp_path / "x")


@pytest.fixture
def events_of_five_ticks(tmp_path: Path) -> Path:
    """A compressed file of events in which robot 7 receives an estimate in each of five ticks."""
    with events_file(tmp_path / "x.events", header_of(7)) as writer:
        for tick in range(5):
            writer.recorders[7].record_estimates([[3, tick, tick]])
            writer.recorders[7].record_settle()
    return tmp_path / "x.events"


@pytest.mark.parametrize("cut_bytes", [1, 8, 9, 20, 30])
def test_the_events_of_a_killed_run_are_read_up_to_where_they_were_cut(
    cut_bytes: int, events_of_five_ticks: Path
) -> None:
    """The last 1 to 30 bytes of a compressed file are missing. The entries before the cut are read unchanged.

    The name of the file ends in ``.part``, as the run did not end. A cut in the last 8 bytes, gzip's check
    value, loses no entry.
    """
    all_entries = read_entries(events_of_five_ticks)
    part = events_of_five_ticks.with_suffix(".events.part")
    part.write_bytes(events_of_five_ticks.read_bytes()[:-cut_bytes])

    entries_before_cut = read_entries(part)

    assert entries_before_cut == all_entries[: len(entries_before_cut)]
    if cut_bytes <= 8:
        assert entries_before_cut == all_entries


def test_a_complete_last_line_of_a_killed_run_is_read(tmp_path: Path) -> None:
    """Lines are of robots 7 and 0, which observe black (1) and end the tick (3).

    The name of the file ends in ``.part``, as the run did not end. Somebody has decompressed it.
    """
    (tmp_path / "x.part").write_text(f"{FIRST_LINE_OF_ROBOTS_0_AND_7}[7,1,3]\n[0,1,3]\n")
    assert read_entries(tmp_path / "x.part") == [
        RobotEvents(7, [BLACK, END_OF_TICK]),
        RobotEvents(0, [BLACK, END_OF_TICK]),
    ]


def test_an_incomplete_last_line_of_a_killed_run_is_ignored(tmp_path: Path) -> None:
    """The line of robot 0 breaks off. Robot 7 observes black (1) and ends the tick (3): its line is complete.

    The name of the file ends in ``.part``, as the run did not end. Somebody has decompressed it.
    """
    (tmp_path / "x.part").write_text(f"{FIRST_LINE_OF_ROBOTS_0_AND_7}[7,1,3]\n[0,1")
    assert read_entries(tmp_path / "x.part") == [RobotEvents(7, [BLACK, END_OF_TICK])]


def test_a_line_without_an_end_does_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small compressed file can hold an endless line; only MAX_LINE_LENGTH characters are read."""
    monkeypatch.setattr(events_module, "MAX_LINE_LENGTH", 2000)
    line_of_two_million_characters = "[" + 10**6 * "0,"
    with gzip.open(tmp_path / "x", "wt") as file:
        file.write(FIRST_LINE_OF_ROBOTS_0_AND_7 + line_of_two_million_characters)

    with pytest.raises(UsageError, match="line 2: not JSON of at most 2000 characters"):
        read_entries(tmp_path / "x")


# --- Malformed lines ----------------------------------------------------------------------------------


def changed_header(key: str, value: Any) -> str:
    """Return the first line with another value at a key, which may be one of the first robot."""
    plain_header = json.loads(FIRST_LINE_OF_ROBOTS_0_AND_7)
    target = plain_header if key in plain_header else plain_header["robots"][0]
    target[key] = value
    return json.dumps(plain_header)


@pytest.mark.parametrize(
    ("first_line", "expected_message"),
    [
        ("", '"format": "mcp-asdf events" is missing'),
        ("{}", '"format": "mcp-asdf events" is missing'),
        ("(1.0) vcan0 1#00", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("\xff\xfe", "not JSON"),
        (changed_header("version", 2), "the format is version 2, and versions 3 to 5 are read here; replay"),
        (changed_header("version", 6), "the format is version 6, and versions 3 to 5 are read here"),
        (changed_header("robots", 5), "robots is 5; it must be a list in brackets"),
        (header_of(7, 7).to_line(), "two robots have the same id"),
        (changed_header("frames", {"subject": 6144, "priority": 4}), "subject is 6144"),
        (changed_header("parameters", []), "parameters is []; it must be an object in braces"),
        (changed_header("versions", "5"), "versions is '5'; it must be an object in braces"),
        (changed_header("filter", "x"), "filter is 'x'; it must be one of adaptive, always, off"),
    ],
    ids=lambda text: text[-40:],
)
def test_a_malformed_header_is_refused(first_line: str, expected_message: str, tmp_path: Path) -> None:
    """The header is the first line, a JSON object on the run and its robots. The error says what is wrong.

    Some first lines have bytes that are no UTF-8; Latin-1 writes any character up to 255 as its byte.
    """
    (tmp_path / "x").write_text(first_line, encoding="latin-1")
    with pytest.raises(UsageError) as caught:
        read_entries(tmp_path / "x")
    assert f"x, line 1: {expected_message}" in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "expected_message"),
    [
        ("[0,1", "line 2: not JSON"),
        ("[0,1,3]\n{}", "line 3: neither a robot with its events nor a frame"),
        ("[]", "line 2: neither a robot with its events nor a frame"),
        ("[true,1]", "line 2: neither a robot with its events nor a frame"),
        ("[5,1]", "line 2: robot 5 is not in the first line"),
        ('[0,1,[1,2,3],"2"]\n[7,"6"]', "line 3: '6' refers to a robot of which no message is told before"),
        ("[0,4]", "line 2: 4 is no event"),
        ("[0,1.0]", "line 2: 1.0 is no event"),
        ("[0,[1]]", "line 2: [1] is no event"),
        ("[0,[1,2,3,4]]", "line 2: [1, 2, 3, 4] is no event"),
        ("[0,[1,2,-3]]", "line 2: [1, 2, -3] is no event"),
        ("[0,[1,2,4294967296]]", "line 2: [1, 2, 4294967296] is no event"),
        ('[0,"lost"]', "line 2: 'lost' is no event"),
        ('[0,""]', "line 2: '' is no event"),
        (f'[0,"{"1" * 33}"]', f"line 2: '{'1' * 33}' is no event"),
    ],
)
def test_a_malformed_line_is_refused_with_its_number(
    lines: str, expected_message: str, tmp_path: Path
) -> None:
    """A line is a list of a robot's id and its events, or a text with a frame. The error quotes any other.

    For example, robot 0 has no event 4, so "[0,4]" is refused: "line 2: 4 is no event".
    """
    (tmp_path / "x").write_text(FIRST_LINE_OF_ROBOTS_0_AND_7 + lines)
    with pytest.raises(UsageError) as caught:
        read_entries(tmp_path / "x")
    assert f"x, {expected_message}" in str(caught.value)


def test_a_missing_file_of_events_is_refused(tmp_path: Path) -> None:
    """The error names the file and has the reason that the system gives."""
    with pytest.raises(UsageError, match=r"cannot read .*absent: No such file"):
        EventsReader(tmp_path / "absent")
