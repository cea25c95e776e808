"""Ground truth: arena, floor, sensors, who hears whom, and every random number."""

from .arena import Arena as Arena
from .arena import config_values as config_values
from .floor_code import code as code
from .sensors import SensorModel as SensorModel
from .sensors import black_probabilities as black_probabilities
from .sensors import sensor_model as sensor_model
from .settings import MAX_PERIOD as MAX_PERIOD
from .settings import TOPOLOGIES as TOPOLOGIES
from .settings import Floor as Floor
from .settings import WorldSettings as WorldSettings
from .settings import default_of as default_of
from .topology import Graph as Graph
from .world import Scene as Scene
from .world import World as World
