"""T-tables: thresholds, files for deployment with or without the firmware, and tables inside built images."""

from .firmware_folder import write_firmware as write_firmware
from .image_scan import verify_image as verify_image
from .table_files import TableCheck as TableCheck
from .table_files import check_file as check_file
from .table_files import describe as describe
from .table_files import write as write
from .thresholds import MAX_MESSAGES as MAX_MESSAGES
from .thresholds import OMEGA_PLACES as OMEGA_PLACES
from .thresholds import check_q as check_q
from .thresholds import generate as generate
from .thresholds import omega_from_word as omega_from_word
from .thresholds import parse_omega as parse_omega
from .thresholds import true_thresholds as true_thresholds
from .thresholds import worst_threshold_error as worst_threshold_error
