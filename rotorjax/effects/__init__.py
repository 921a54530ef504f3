"""The catalogue of effects. Equations and signs: each class; every one is tested against an independent answer."""

from types import MappingProxyType

from rotorjax.effects.excitation import Misalignment as Misalignment
from rotorjax.effects.excitation import PlaneParticipation as PlaneParticipation
from rotorjax.effects.excitation import ResidualBow as ResidualBow
from rotorjax.effects.excitation import ResidualUnbalance as ResidualUnbalance
from rotorjax.effects.excitation import SweepRate as SweepRate
from rotorjax.effects.excitation import ThermalBow as ThermalBow
from rotorjax.effects.reading import ChainGain as ChainGain
from rotorjax.effects.reading import PhaseReferenceOffset as PhaseReferenceOffset
from rotorjax.effects.reading import ProbeAngle as ProbeAngle
from rotorjax.effects.reading import ProbeGain as ProbeGain
from rotorjax.effects.reading import Runout as Runout
from rotorjax.effects.reading import SpeedError as SpeedError
from rotorjax.effects.reading import TimeDelay as TimeDelay
from rotorjax.effects.restoring import AsymmetricShaft as AsymmetricShaft
from rotorjax.effects.restoring import Clearance as Clearance
from rotorjax.effects.restoring import CoulombFriction as CoulombFriction
from rotorjax.effects.restoring import Crack as Crack
from rotorjax.effects.restoring import Duffing as Duffing
from rotorjax.effects.restoring import ProbeSaturation as ProbeSaturation
from rotorjax.effects.restoring import QuadraticDamping as QuadraticDamping
from rotorjax.effects.restoring import Rub as Rub
from rotorjax.effects.structure import CrossCoupling as CrossCoupling
from rotorjax.effects.structure import DampingError as DampingError
from rotorjax.effects.structure import Foundation as Foundation
from rotorjax.effects.structure import Gyroscopic as Gyroscopic
from rotorjax.effects.structure import InternalDamping as InternalDamping
from rotorjax.effects.structure import MassError as MassError
from rotorjax.effects.structure import SpeedDependentCrossCoupling as SpeedDependentCrossCoupling
from rotorjax.effects.structure import SpeedDependentDamping as SpeedDependentDamping
from rotorjax.effects.structure import SpeedDependentStiffness as SpeedDependentStiffness
from rotorjax.effects.structure import StiffnessAxes as StiffnessAxes
from rotorjax.effects.structure import StiffnessError as StiffnessError
from rotorjax.model.contract import Effect

_CLASSES: tuple[type[Effect], ...] = (
    ResidualUnbalance,
    ResidualBow,
    ThermalBow,
    Misalignment,
    PlaneParticipation,
    SweepRate,
    StiffnessError,
    MassError,
    DampingError,
    StiffnessAxes,
    CrossCoupling,
    SpeedDependentStiffness,
    SpeedDependentDamping,
    SpeedDependentCrossCoupling,
    InternalDamping,
    Foundation,
    Gyroscopic,
    Duffing,
    Clearance,
    Rub,
    Crack,
    AsymmetricShaft,
    QuadraticDamping,
    CoulombFriction,
    ProbeGain,
    ChainGain,
    ProbeAngle,
    PhaseReferenceOffset,
    TimeDelay,
    Runout,
    ProbeSaturation,
    SpeedError,
)

CATALOG: MappingProxyType[str, type[Effect]] = MappingProxyType({cls.name: cls for cls in _CLASSES})
"""Effect name -> class, grouped by family. Extend it without changing it: ``CATALOG | {"mine": Mine}``."""
