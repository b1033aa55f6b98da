"""Energy balance of the plant, in which each entry is integrated independently."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EnergyLedger:
    """Energies since the start [J]. No entry is computed as the remainder of the others."""

    electrical: float  #: Work of the amplifiers, the integral of v i
    external: float  #: Work from outside, when the robot is lifted or its mass is changed
    copper: float  #: Loss in the windings, the integral of R i^2
    gear: float  #: Loss in the gears
    shaft: float  #: Loss by viscous and Coulomb friction at the axles
    roller: float  #: Loss by the drag of the rotating rollers
    slip: float  #: Loss by slip along the rollers' axes
    kinetic: float  #: Change of the kinetic energy of body and wheels
    inductive: float  #: Change of the energy L i^2 / 2 in the motors
    turnover: float  #: Integral of the magnitudes of all powers, the scale of `residual`

    @property
    def losses(self) -> dict[str, float]:
        """Losses by name [J]."""
        return {
            name: getattr(self, name) for name in ("copper", "gear", "shaft", "roller", "slip")
        }

    @property
    def residual(self) -> float:
        """Input work minus losses and stored energy, which is zero up to rounding [J]."""
        stored = self.kinetic + self.inductive
        return self.electrical + self.external - sum(self.losses.values()) - stored
