"""Many trials without a bus: parameters, engine, results, scores and plots."""

from . import arena_plots as arena_plots
from . import plots as plots
from .authors_formats import write_authors_json as write_authors_json
from .experiment import Convention as Convention
from .experiment import Experiment as Experiment
from .experiment_files import STUDIES as STUDIES
from .experiment_files import read_experiments as read_experiments
from .plots import MODE_NAMES as MODE_NAMES
from .results import Trials as Trials
from .results import describe as describe
from .results import experiments_in as experiments_in
from .results import read_table as read_table
from .results import table_of as table_of
from .results import write_csv as write_csv
from .scores import Limits as Limits
from .scores import Scores as Scores
from .scores import found_limits as found_limits
from .scores import score as score
from .simulation import run_trials as run_trials
from .sweep import Report as Report
from .sweep import Store as Store
from .sweep import default_workers as default_workers
from .sweep import run_sweep as run_sweep
