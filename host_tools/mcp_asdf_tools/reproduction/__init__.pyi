"""The paper's study: its experiments, claims and figures."""

from . import study_report as study_report
from .study import PART_NAMES as PART_NAMES
from .study import PERIODS as PERIODS
from .study import QUICK as QUICK
from .study import Part as Part
from .study import Scale as Scale
from .study import cells_of as cells_of
from .study import experiment_of as experiment_of
from .study import study_of as study_of
from .study_report import Decided as Decided
from .verdicts import Verdict as Verdict
