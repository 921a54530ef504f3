"""Pictures: every function draws on the axes it is given and returns them. Amplitudes in µm, speeds in rpm."""

from rotorjax.reporting.plots.campbell import campbell as campbell
from rotorjax.reporting.plots.canvas import COLOURS as COLOURS
from rotorjax.reporting.plots.canvas import figure as figure
from rotorjax.reporting.plots.canvas import legend_above as legend_above
from rotorjax.reporting.plots.canvas import plain as plain
from rotorjax.reporting.plots.canvas import svg as svg
from rotorjax.reporting.plots.captions import CAPTIONS as CAPTIONS
from rotorjax.reporting.plots.misfit import correlations as correlations
from rotorjax.reporting.plots.misfit import error_fall as error_fall
from rotorjax.reporting.plots.misfit import missing_force as missing_force
from rotorjax.reporting.plots.misfit import probabilities as probabilities
from rotorjax.reporting.plots.misfit import residual_map as residual_map
from rotorjax.reporting.plots.orbits import centreline as centreline
from rotorjax.reporting.plots.orbits import full_spectrum as full_spectrum
from rotorjax.reporting.plots.orbits import orbit as orbit
from rotorjax.reporting.plots.orbits import record_orbit as record_orbit
from rotorjax.reporting.plots.records import phase_picture as phase_picture
from rotorjax.reporting.plots.records import waveform as waveform
from rotorjax.reporting.plots.spectra import cascade as cascade
from rotorjax.reporting.plots.spectra import waterfall as waterfall
from rotorjax.reporting.plots.study import convergence as convergence
from rotorjax.reporting.plots.study import error_cloud as error_cloud
from rotorjax.reporting.plots.study import grouped_bars as grouped_bars
from rotorjax.reporting.plots.vectors import before_after as before_after
from rotorjax.reporting.plots.vectors import bode as bode
from rotorjax.reporting.plots.vectors import polar as polar
