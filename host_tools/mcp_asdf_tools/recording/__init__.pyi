"""Recordings of a bus and of what each robot saw: written, read and replayed."""

from .frame_logs import Outputs as Outputs
from .frame_logs import logging_to as logging_to
from .frame_logs import read_log as read_log
from .replay import Playback as Playback
from .replay import Player as Player
from .replay import Verdict as Verdict
from .replay import verify as verify
from .sidecar import Header as Header
from .sidecar import SidecarReader as SidecarReader
from .sidecar import SidecarWriter as SidecarWriter
from .sidecar import sidecar_path as sidecar_path
