"""Where the energy goes: a ledger in which each entry has its own expression."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EnergyLedger:
    """Energies since the start, J. No entry is computed as what is left of the others.

    Attributes:
        electrical: Work of the amplifiers, integral of v i.
        external: Work of hands on the robot: set on blocks in motion, mass changed in motion.
        copper: Integral of R i^2.
        gear: Loss in the gears.
        shaft: Viscous and Coulomb friction at the axles.
        roller: Drag of the turning rollers.
        slip: Slip along the rollers' axes.
        kinetic: Change of the kinetic energy of body and wheels.
        inductive: Change of the energy L i^2 / 2 in the motors.
        turnover: Sum of the magnitudes of all these powers, integrated: the measure for residual.
    """

    electrical: float
    external: float
    copper: float
    gear: float
    shaft: float
    roller: float
    slip: float
    kinetic: float
    inductive: float
    turnover: float

    @property
    def losses(self) -> dict[str, float]:
        """Each loss by name, J."""
        return {
            name: getattr(self, name) for name in ("copper", "gear", "shaft", "roller", "slip")
        }

    @property
    def residual(self) -> float:
        """Work put in, less losses and stored energy: zero but for round-off, J."""
        stored = self.kinetic + self.inductive
        return self.electrical + self.external - sum(self.losses.values()) - stored
