"""The C firmware against its mirror, float64 and exact arithmetic."""

from .compare import Check as Check
from .compare import Disagreement as Disagreement
from .compare import Firmware as Firmware
from .compare import Subject as Subject
from .compare import compare_firmwares as compare_firmwares
from .compare import crosscheck as crosscheck
from .compare import shrink as shrink
from .operation_count import CallCount as CallCount
from .operation_count import count_operations as count_operations
from .operation_count import measure_storage as measure_storage
from .operation_plot import draw as draw
from .oracle import Audit as Audit
from .report import Failure as Failure
from .report import Result as Result
from .scenario import Scenario as Scenario
from .scenario import parse_scenario as parse_scenario
