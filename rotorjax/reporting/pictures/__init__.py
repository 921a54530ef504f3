"""The pictures of a comparison or an explanation: which views to draw; the drawing itself is in `plots`."""

from rotorjax.reporting.pictures.of_result import Plots as Plots
from rotorjax.reporting.pictures.report import explanation_pictures as explanation_pictures
from rotorjax.reporting.pictures.report import first_pictures as first_pictures
from rotorjax.reporting.pictures.report import headline_figure as headline_figure
from rotorjax.reporting.pictures.report import story_pictures as story_pictures
