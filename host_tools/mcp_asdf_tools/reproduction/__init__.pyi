"""The paper's study: its experiments, claims and figures."""

from . import report as report
from .runs import StudyFolder as StudyFolder
from .study import PAPER as PAPER
from .study import PERIODS as PERIODS
from .study import QUICK as QUICK
from .study import Part as Part
from .study import Scale as Scale
