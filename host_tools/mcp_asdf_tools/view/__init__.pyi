"""A run as a page in a browser, from a recording or live."""

from .film import Film as Film
from .film import LiveFilm as LiveFilm
from .films import BusFilm as BusFilm
from .films import SwarmCamera as SwarmCamera
from .films import film_of_log as film_of_log
from .films import film_of_trial as film_of_trial
from .page import page as page
from .server import serving as serving
