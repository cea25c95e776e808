"""Emulated neighbours of one real controller, and the verdict on it."""

from .neighbourhood import Neighbourhood as Neighbourhood
from .neighbourhood import RadioSettings as RadioSettings
from .neighbourhood import choose_ids as choose_ids
from .neighbourhood import configured_like as configured_like
from .real_time import RadioRun as RadioRun
from .test_bench import BenchOptions as BenchOptions
from .verification import COLUMNS as COLUMNS
from .verification import ControllerVerdict as ControllerVerdict
from .verification import Verification as Verification
from .verification import check_report_path as check_report_path
from .verification import write_report as write_report
