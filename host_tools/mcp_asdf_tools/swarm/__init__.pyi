"""Many robots on emulated media, with faults."""

from .carrier import Wiring as Wiring
from .delivery import Delivery as Delivery
from .delivery import SentFrame as SentFrame
from .fault_spec import Fault as Fault
from .fault_spec import FaultKind as FaultKind
from .fault_spec import parse_fault as parse_fault
from .faults import Faults as Faults
from .live_view import LiveView as LiveView
from .plot import draw as draw
from .remote_robot import check_remote as check_remote
from .settings import MAX_ROBOTS_AND_TOOLS as MAX_ROBOTS_AND_TOOLS
from .settings import SwarmSettings as SwarmSettings
from .summary import Rows as Rows
from .summary import comparison as comparison
from .summary import load_warning as load_warning
from .summary import one_line as one_line
from .summary import summary as summary
from .summary import summary_table as summary_table
from .swarm import Companion as Companion
from .swarm import Swarm as Swarm
from .swarm import SwarmHook as SwarmHook
from .swarm import SwarmRun as SwarmRun
from .swarm import run_swarm as run_swarm
