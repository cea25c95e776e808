"""Recordings of a bus and of what each robot saw: written, read and replayed."""

from .frame_logs import add_log_option as add_log_option
from .frame_logs import read_log as read_log
from .recording import LogOutputs as LogOutputs
from .recording import NoRecording as NoRecording
from .recording import Recording as Recording
from .recording import recording_to as recording_to
from .replay import Playback as Playback
from .replay import Player as Player
from .replay import ReplayVerdict as ReplayVerdict
from .replay import rerun as rerun
from .replay import verify as verify
from .sidecar import SidecarHeader as SidecarHeader
from .sidecar import SidecarReader as SidecarReader
from .sidecar import SidecarWriter as SidecarWriter
from .sidecar import sidecar_of as sidecar_of
from .sidecar import sidecar_path as sidecar_path
