"""Recordings of a bus and of what each robot saw: written, read and replayed."""

from .frame_logs import PART as PART
from .frame_logs import add_log_option as add_log_option
from .frame_logs import check_log as check_log
from .frame_logs import read_log as read_log
from .input_log import InputLogHeader as InputLogHeader
from .input_log import InputLogReader as InputLogReader
from .input_log import InputLogWriter as InputLogWriter
from .input_log import input_log_of as input_log_of
from .input_log import input_log_path as input_log_path
from .recording import LogOutputs as LogOutputs
from .recording import NoRecording as NoRecording
from .recording import Recording as Recording
from .replay import Playback as Playback
from .replay import Player as Player
from .replay import ReplayVerdict as ReplayVerdict
from .replay import rerun as rerun
from .replay import verify as verify
