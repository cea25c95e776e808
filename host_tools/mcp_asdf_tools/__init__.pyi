"""Tools around the firmware ``mcp_asdf``: experiments, swarms on a CAN bus, scores and plots.

docs/library.md has an example of each.
"""

from .common import UsageError as UsageError
from .experiments import Experiment as Experiment
from .experiments import experiments_in as experiments_in
from .experiments import grid as grid
from .experiments import read_experiments as read_experiments
from .experiments import read_table as read_table
from .library import emulate as emulate
from .library import plot as plot
from .library import score as score
from .library import simulate as simulate
from .library import start_swarm as start_swarm
from .swarm import SwarmSettings as SwarmSettings
