"""Emulated neighbours of one real controller, and the verdict on it."""

from .neighbourhood import Neighbourhood as Neighbourhood
from .neighbourhood import RadioSettings as RadioSettings
from .neighbourhood import choose_ids as choose_ids
from .neighbourhood import configured_like as configured_like
from .real_time import RadioRun as RadioRun
from .stage import ControllerBench as ControllerBench
from .verification import Verification as Verification
from .verification_report import COLUMNS as COLUMNS
from .verification_report import check_report_path as check_report_path
from .verification_report import headline as headline
from .verification_report import sections as sections
from .verification_report import write_verification_report as write_verification_report
