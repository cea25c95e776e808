"""The paper's study: its experiments, claims and figures."""

from . import report_text as report_text
from . import study_report as study_report
from .runs import Run as Run
from .runs import StudyFolder as StudyFolder
from .runs import seconds_of as seconds_of
from .study import PAPER as PAPER
from .study import PAPER_TRIALS as PAPER_TRIALS
from .study import PART_NAMES as PART_NAMES
from .study import PERIODS as PERIODS
from .study import QUICK as QUICK
from .study import Part as Part
from .study import Scale as Scale
from .verdicts import Verdict as Verdict
