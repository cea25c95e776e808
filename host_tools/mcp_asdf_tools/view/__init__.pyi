"""A run as a page in a browser, from a recording or live, and as an animation."""

from .animation import check_animation_path as check_animation_path
from .animation import image_of_film as image_of_film
from .bus_film import BusFilm as BusFilm
from .film import Film as Film
from .film import LiveFilm as LiveFilm
from .page import page as page
from .server import serving as serving
from .sources import film_of_log as film_of_log
from .sources import film_of_trial as film_of_trial
from .swarm_film import SwarmCamera as SwarmCamera
