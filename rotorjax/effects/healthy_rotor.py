"""How a healthy rotor differs from a disk on a shaft: what `rotorjax.discovery.healthy` fits to its measurement."""

from types import MappingProxyType
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from rotorjax.arrays import diagonal
from rotorjax.effects.excitation import ResidualBow, ResidualUnbalance
from rotorjax.effects.reading import Runout
from rotorjax.effects.structure import (
    CrossCoupling,
    Gyroscopic,
    InternalDamping,
    MassError,
    SpeedDependentDamping,
    SpeedDependentStiffness,
    StiffnessError,
)
from rotorjax.model.contract import (
    Effect,
    Excitation,
    ExcitationEffect,
    Family,
    Matrices,
    MatrixEffect,
    OperatingPoint,
    Reading,
    ReadingEffect,
)
from rotorjax.model.parameters import parameter


class HealthyRotor(MatrixEffect):
    """What is added to M, C and K of a disk on a shaft:

    M += e_m M
    C += diag(c_i d_i)
    K += diag(k_i e_i) + κ [0 1; 1 0]
    """

    name: ClassVar[str] = "healthy_rotor"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "how the healthy rotor differs from the rig file in mass, damping and stiffness"
    source: ClassVar[str] = (
        "Friswell, Mottershead, Finite Element Model Updating in Structural Dynamics, Kluwer 1995, chapter 8"
    )
    relatives: ClassVar[tuple[str, ...]] = ("stiffness_error", "damping_error", "mass_error")
    stiffness_x: Array = parameter("relative error of the stiffness along x", scale=0.05)
    stiffness_y: Array = parameter("relative error of the stiffness along y", scale=0.05)
    stiffness_xy_n_per_m: Array = parameter("symmetric stiffness between x and y", scale=0.02, of="stiffness")
    damping_x: Array = parameter("relative error of the damping along x", scale=0.5)
    damping_y: Array = parameter("relative error of the damping along y", scale=0.5)
    mass: Array = parameter("relative error of the mass", scale=0.05)
    starts: ClassVar[tuple[dict[str, float], ...]] = (
        {},
        *({"stiffness_x": off, "stiffness_y": off} for off in (1.0, -1.0, 2.0, -2.0)),
    )

    def matrices(self, point: OperatingPoint) -> Matrices:
        damping = jnp.stack([self.damping_x, self.damping_y]) * point.rotor.damping
        turned = self.stiffness_xy_n_per_m * jnp.array([[0.0, 1.0], [1.0, 0.0]])
        return _sum_of(
            Matrices(path_damping=diagonal(damping), path_stiffness=turned),
            StiffnessError(self.stiffness_x, self.stiffness_y).matrices(point),
            MassError(self.mass).matrices(point),
        )


class HealthyDetail(MatrixEffect):
    """What a disk on a shaft does not have, all at once:

        C += diag(c_i f (ω_r/Ω - 1)) + c_r I + Ω g J
        K += diag(k_i h_i Ω²/ω_r²) + (k + c_r Ω) J

    ω_r is the mean natural frequency. With it the model answers nearly as a flexible shaft with mass, a tilting disk,
    unequal bearings with damping in series do at the disk, at speeds about one resonance.
    """

    name: ClassVar[str] = "healthy_detail"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "what the healthy rotor has and a disk on a shaft does not, as its speed shows it"
    source: ClassVar[str] = (
        "Friswell, Mottershead, Finite Element Model Updating in Structural Dynamics, Kluwer 1995, chapter 8"
    )
    relatives: ClassVar[tuple[str, ...]] = ("gyroscopic", "cross_coupling", "internal_damping")
    cross_stiffness_n_per_m: Array = parameter("cross-coupled stiffness k", scale=0.02, of="stiffness")
    stiffening_x: Array = parameter("relative growth of the stiffness along x at the natural frequency", scale=0.1)
    stiffening_y: Array = parameter("relative growth of the stiffness along y at the natural frequency", scale=0.1)
    falling_damping: Array = parameter("part of the damping at the natural frequency that falls with speed", scale=0.5)
    turning_damping_n_s_per_m: Array = parameter("damping that turns with the shaft", scale=1.0, of="damping")
    inertia_ratio_kg: Array = parameter("polar moment of inertia times (slope / deflection)²", scale=0.05, of="mass")

    def matrices(self, point: OperatingPoint) -> Matrices:
        return _sum_of(
            SpeedDependentStiffness(self.stiffening_x, self.stiffening_y).matrices(point),
            CrossCoupling(self.cross_stiffness_n_per_m).matrices(point),
            SpeedDependentDamping(self.falling_damping).matrices(point),
            InternalDamping(self.turning_damping_n_s_per_m).matrices(point),
            Gyroscopic(self.inertia_ratio_kg).matrices(point),
        )


def _sum_of(*parts: Matrices) -> Matrices:
    return Matrices(*(sum(each) for each in zip(*parts, strict=True)))


class HealthyExcitation(ExcitationEffect):
    """F_1 += Ω² (U_x + iU_y) f; s += S_x + iS_y; F_0 += M (a g + b J g): every rotor has some unbalance and bow of its
    own, and the weight bends a shaft with mass otherwise than its vibration does.
    """

    name: ClassVar[str] = "healthy_excitation"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "unbalance and bow that the healthy rotor has, and how its sag differs from the rig file"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 4.2"
    relatives: ClassVar[tuple[str, ...]] = ("residual_unbalance", "residual_bow")
    unbalance_x_kg_m: Array = parameter("unbalance along x", scale=1.0, of="unbalance")
    unbalance_y_kg_m: Array = parameter("unbalance 90° on in the sense of rotation", scale=1.0, of="unbalance")
    bow_x_m: Array = parameter("bow along x", scale=2.0, of="eccentricity")
    bow_y_m: Array = parameter("bow 90° on in the sense of rotation", scale=2.0, of="eccentricity")
    sag_along: Array = parameter("part of the weight along it", scale=0.05)
    sag_across: Array = parameter("part of the weight across it", scale=0.05)

    def excitation(self, point: OperatingPoint) -> Excitation:
        weight = point.rotor.mass * point.rotor.gravity
        sag = self.sag_along * weight + self.sag_across * jnp.stack([-weight[1], weight[0]])
        unbalance = ResidualUnbalance(self.unbalance_x_kg_m, self.unbalance_y_kg_m).excitation(point)
        bow = ResidualBow(self.bow_x_m, self.bow_y_m).excitation(point)
        return Excitation(force=unbalance.force + point.at_order(0.0) * sag, offset=bow.offset)


class HealthyRunout(ReadingEffect):
    """z += r, one complex number per probe and order: the runout that the healthy rotor has."""

    name: ClassVar[str] = "healthy_runout"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "runout that the healthy rotor has"
    source: ClassVar[str] = "API 670, 5th edition, 2014, section 6.1"
    relatives: ClassVar[tuple[str, ...]] = ("runout",)
    real_m: Array = parameter("runout in phase with the reference", scale=1.0, of="runout", axes=("probe", "order"))
    imaginary_m: Array = parameter("runout 90° ahead", scale=1.0, of="runout", axes=("probe", "order"))

    def reading(self, point: OperatingPoint) -> Reading:
        return Runout(self.real_m, self.imaginary_m).reading(point)


HEALTHY: MappingProxyType[str, type[Effect]] = MappingProxyType(
    {cls.name: cls for cls in (HealthyRotor, HealthyDetail, HealthyExcitation, HealthyRunout)}
)
"""Name -> class: what the model of a healthy rotor has beside the effects that the rig file states."""
