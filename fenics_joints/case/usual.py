"""Usual ranges of the values of a case, so wide that no reasonable choice is outside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any


@dataclass(frozen=True)
class Usual:
    """The usual range of a kind of quantity.

    Attributes:
        what: Subject and verb that stand before the range, such as "solid materials have".
        low: Lower end, SI.
        high: Upper end, SI.
        unit: SI unit; ``""`` for a ratio.
        zero: Whether zero is usual too, though below the range.
    """

    what: str
    low: float
    high: float
    unit: str = ""
    zero: bool = False

    def holds(self, value: float) -> bool:
        """Whether a value is within the range."""
        return self.low <= value <= self.high or (self.zero and value == 0)


#: The ranges by kind, with where each is from.
USUAL = {
    # Ashby, Materials Selection in Mechanical Design, E against density: polymers 0.1 GPa and more,
    # diamond 1200 GPa; densities from balsa wood, 100 kg/m3, to osmium, 22,600.
    "E": Usual("solid materials have", 1e8, 1.2e12, "Pa"),
    "G": Usual("solid materials have", 3e7, 5.5e11, "Pa"),
    "rho": Usual("solid materials have", 100.0, 23e3, "kg/m3"),
    # sqrt(E/rho) on Ashby's chart: soft polymers 300 m/s, diamond 18 km/s. Of steel with E in
    # MPa it is 160 m/s.
    "speed": Usual("sound in bars of solid materials runs at", 250.0, 2e4, "m/s"),
    # Cork 0, metals 0.2 (cast iron) to 0.45 (lead, gold), polymers up to 0.48.
    "nu": Usual("solid materials have", 0.0, 0.49),
    # The papers' layers have 0.9 MPa to 6.1 GPa; none is stiffer than its parts, and one of 0.1 mm
    # with 10 kPa gives 0.1 N/mm3, a hundredth of a rubber sheet of that thickness.
    "layer": Usual("layers of joints have", 1e4, 1.2e12, "Pa"),
    # The papers' layers are 0.5 to 0.72 mm; roughness is a micrometre, a gasket some millimetres.
    "h": Usual("layers of joints have", 1e-6, 2e-2, "m"),
    # From a foil to the bed of a large machine tool.
    "length": Usual("dimensions of bolted structures are", 1e-5, 50.0, "m", zero=True),
    # One MPa in the shank is a bolt that is about to fall out; property class 12.9 breaks at 1220
    # MPa (ISO 898-1).
    "bolt stress": Usual("bolts have", 1e6, 1.22e9, "Pa"),
    # Without a thread: an M1.6 at a tenth of its strength to an M100 of class 12.9.
    "bolt force": Usual("bolts have", 50.0, 1e7, "N"),
    "bolt torque": Usual("bolts are tightened to", 0.01, 3e4, "N*m"),
    # VDI 2230, table A5: 0.04 to 0.35 in threads; dry metals up to 0.8, clean titanium or aluminium
    # on themselves to 1.3.
    "friction": Usual("coefficients of friction are", 0.03, 1.3, zero=True),
    # Bickford, Introduction to the Design and Behavior of Bolted Joints: 0.1 to 0.35 measured.
    "nut factor": Usual("nut factors are", 0.07, 0.5),
    "diameter": Usual("shanks of bolts have", 1e-3, 0.2, "m"),
    # Flatness of machined faces is below 0.1 mm; fits interfere by less.
    "gap": Usual("gaps between faces that are to touch are at most", -2e-3, 2e-3, "m"),
    # From the smallest accelerometer to a large machine's component.
    "mass": Usual("attached masses are", 1e-5, 1e4, "kg"),
    # A rubber band to a machine's foot.
    "stiffness": Usual("springs have", 1.0, 1e11, "N/m"),
    # From the elements of lapped beams: Jalali et al. 2019 has 1.7e3 and 1.5e5 N m.
    "turning": Usual("springs of laps have", 1.0, 1e9, "N*m"),
    "axial": Usual("springs of laps have", 1e3, 1e13, "N/m"),
    "damper": Usual("laps of beams have", 1e-6, 1e4, "N*m*s", zero=True),
    # A tall machine to ultrasound; accelerometers end at 50 kHz, laser vibrometers beyond.
    "frequency": Usual("modes of bolted structures are measured at", 0.1, 1e5, "Hz"),
    # Bare metal 1e-5, bolted structures 1e-4 to 5e-2 (Adams and Askenazi; the papers: below 2 %).
    "damping ratio": Usual("damping ratios of bolted structures are", 1e-6, 0.1, zero=True),
    "loss factor": Usual("loss factors of bolted structures are", 1e-6, 0.5, zero=True),
    # Ratio 0.2 at 100 Hz by mass alone is alpha = 250 1/s; at 10 Hz by stiffness alone beta = 6 ms.
    "alpha": Usual("Rayleigh's alpha is", 1e-6, 1e4, "1/s", zero=True),
    "beta": Usual("Rayleigh's beta is", 1e-12, 2e-2, "s", zero=True),
    "relaxation": Usual("relaxation times are", 1e-12, 2e-2, "s", zero=True),
    # Repeated tests agree to 1e-4; after a joint was taken apart to some per cent.
    "noise": Usual("relative scatter of measured frequencies is", 1e-5, 0.1),
    "damping noise": Usual("relative scatter of damping ratios is", 1e-4, 1.0, zero=True),
    "tolerance": Usual("relative tolerances are", 1e-6, 0.5),
    "discrepancy": Usual("relative errors of models are", 1e-6, 0.5, zero=True),
    "resolution": Usual("lines of analysers are apart by", 1e-4, 100.0, "Hz", zero=True),
    # A hammer tap by a fingernail to a hydraulic shaker.
    "level": Usual("forces of excitation are", 1e-4, 1e5, "N"),
    "stress": Usual("curves of joints have", 1.0, 1.2e12, "Pa", zero=True),
    # From faces that rest on each other to below a bolt's head at its limit.
    "contact pressure": Usual("faces of joints are pressed by", 1e3, 1e9, "Pa"),
    # ISO 1302: Ra 0.025 um, lapped, to 50 um, as cast.
    "roughness": Usual("faces of joints have Ra of", 1e-8, 1e-4, "m"),
    "face force": Usual("loads of faces are", -1e7, 1e7, "N"),
    # Small displacements: a grip that moves farther than a few per cent of a structure bends it.
    "travel": Usual("in a preload faces and obstacles are moved by", -1e-2, 1e-2, "m"),
    "per length": Usual("contacts have", 1e6, 1e17, "Pa/m"),
}


def usual(kind: Any, name: str) -> Any:
    """The type of a value that has the usual range of this name."""
    return Annotated[kind, USUAL[name]]
