# SPDX-License-Identifier: Apache-2.0
"""How densely real things were found to lie: each experiment with its source.

Shares are of the bulk volume: what the parts fill (gamma), or for open, hollow parts what their
hulls fill, which is the harder test: a wrong share of thin walls would be small in gamma.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from stack_counter.sim.reality import parts
from stack_counter.sim.shapes import Shape

# How a pile was made: by which end of the sets' friction it is simulated.
LOOSE, POURED, DENSE = "loose", "poured", "dense"

_BAKER = "Baker & Kudrolli, Phys. Rev. E 82 (2010) 061304"
_BILLET = "Billet, Packed Towers (1995), table of packings"
_RINGS = "maker's table, sp-teploobmen.ru (metal Raschig rings: number, bulk density)"
_RODS = "Wouterse, Luding & Philipse 2007: 10 contacts a rod, gamma = 4.9 / a"
_CUP_M3 = 236.6e-6
# A metal Raschig ring's volume in mm3: bulk density in kg/m3 over number and that of steel.
_RING_25, _RING_50 = 400 / 7930 / 50_000 * 1e9, 321 / 7930 / 6_500 * 1e9


@dataclass(frozen=True)
class Tub:
    """A round vessel filled level with its rim; inner sizes in metres."""

    diameter_m: float
    depth_m: float


@dataclass(frozen=True)
class Experiment:
    """One published measurement.

    Attributes:
        name: what lay there.
        part: makes the part.
        pour: LOOSE, POURED or DENSE.
        source: who found it, and where.
        gamma: share of the bulk volume that the parts fill; None if parts were counted.
        per_m3: number of parts in 1 m3 of bulk volume; None if gamma was published.
        spread: half the width of what one or several sources found, as a share.
        fitted: the friction of the pour was fitted on it.
        of_hull: the share is that of the hulls.
        tub: the vessel, if it was small; None for values of the bulk.
        bodies: number of parts of the simulated pile, if there is no tub.
    """

    name: str
    part: Callable[[], Shape]
    pour: str
    source: str
    gamma: float | None = None
    per_m3: float | None = None
    spread: float = 0.01
    fitted: bool = False
    of_hull: bool = False
    tub: Tub | None = None
    bodies: int = 400

    def measured_share(self, shape: Shape) -> float:
        """The published share; a count is multiplied by the volume of the part or its hull."""
        if self.gamma is not None:
            return self.gamma
        if self.per_m3 is None:
            raise ValueError(f"{self.name}: gamma and per_m3 are None; expected one of them")
        return self.per_m3 * counted_volume(self, shape)


def counted_volume(experiment: Experiment, shape: Shape) -> float:
    """Volume of one part, or of its hull, m3: what the experiment's share is the share of."""
    return float(shape.mesh.convex_hull.volume) if experiment.of_hull else shape.unit_volume


def _dice() -> list[Experiment]:
    """Plastic dice: loose from a fluidised bed, dense after long shaking."""
    measured = {"tetrahedron": (0.51, 0.64), "cube": (0.54, 0.67), "octahedron": (0.52, 0.64),
                "dodecahedron": (0.51, 0.63), "icosahedron": (0.50, 0.59)}
    return [Experiment(f"dice: {name}", partial(parts.die, name), pour, _BAKER, gamma,
                       fitted=True)
            for name, shares in measured.items()
            for pour, gamma in zip((LOOSE, DENSE), shares)]


_BALL = partial(parts.ellipsoid, "ball", 20, 20, 20)
_MM = partial(parts.ellipsoid, "M&M", 13.46, 13.46, 6.6)
EXPERIMENTS = [
    Experiment("balls", _BALL, LOOSE, "Jerkins et al., Phys. Rev. Lett. 101 (2008) 018301", 0.55,
               fitted=True),
    Experiment("glass balls, 13 and 25 mm", _BALL, POURED, _BILLET, 0.585, spread=0.015,
               fitted=True),
    Experiment("balls", _BALL, DENSE, "Scott & Kilgour, J. Phys. D 2 (1969) 863", 0.637,
               fitted=True),
    *_dice(),
    # Oblate 1 : 0.5, in a shaken flask
    Experiment("M&M's", partial(parts.ellipsoid, "M&M", 20, 20, 10), DENSE,
               "Donev et al., Science 303 (2004) 990", 0.68, spread=0.015),
    Experiment("ellipsoids 1.25 : 1 : 0.8", partial(parts.ellipsoid, "ellipsoid", 25, 20, 16),
               DENSE, "Man et al., Phys. Rev. Lett. 94 (2005) 198001", 0.74, spread=0.005),
    # 208 g a cup of 0.857 g pieces (mean of 100 in Triola, Elementary Statistics), each 0.60 to
    # 0.65 cm3 (Scientific American, "The Geometry of M&Ms"), 13.5 x 6.4 mm (Star Tribune 2014)
    Experiment("M&M's, a cup", _MM, POURED, "USDA SR: 208 g a cup", per_m3=208 / 0.857 / _CUP_M3,
               spread=0.03, tub=Tub(0.070, 0.0615)),
    Experiment("lentil, Laird", partial(parts.ellipsoid, "lentil", 6.72, 6.72, 2.58), POURED,
               "Isik, Pak. J. Biol. Sci. 10 (2007) 474", 0.70),
    Experiment("lentil, yellow", partial(parts.ellipsoid, "lentil", 4.29, 4.29, 1.22), POURED,
               "Isik & Izli, J. Agric. Sci. 22 (2016) 307", 0.625),
    Experiment("soybean", partial(parts.ellipsoid, "soybean", 6.55, 5.56, 4.53), POURED,
               "Wandkar et al. 2012", 0.60, spread=0.02),
    Experiment("common bean", partial(parts.ellipsoid, "common bean", 17.55, 9.75, 5.83), POURED,
               "J. Food Agric. Environ. 11 (2013) 215", 0.63, spread=0.02),
    Experiment("corn kernel", partial(parts.corn_kernel, 9.87, 7.41, 3.25, 0.220 / 1.315e-3),
               POURED, "Karababa & Coskuner, Int. J. Food Prop. 10 (2007) 549", 0.58),
    # Bulk density 595 kg/m3 at 0.71 cm3 and 0.69 g a kernel; another variety 0.52 to 0.56
    Experiment("almond kernel", partial(parts.almond, 21.19, 14.34, 6.38, 710), POURED,
               "Aydin, J. Food Eng. 60 (2003) 315; Zheng & Fielke 2014", 0.61, spread=0.07),
    Experiment("Raschig ring, metal, 25 mm",
               partial(parts.ring_of_volume, "Raschig ring", 25, _RING_25), POURED, _RINGS,
               per_m3=50_000, spread=0.03, of_hull=True, bodies=150),
    Experiment("Raschig ring, metal, 50 mm",
               partial(parts.ring_of_volume, "Raschig ring", 50, _RING_50), POURED, _RINGS,
               per_m3=6_500, spread=0.03, of_hull=True, bodies=150),
    Experiment("Pall ring, plastic, 25 mm, as a ring", partial(parts.ring, "Pall ring", 25, 25, 1),
               POURED, "maker's table, top-factories.com", per_m3=49_000, spread=0.03,
               of_hull=True, bodies=150),
    # How level the cup was is not said
    Experiment("LEGO 2 x 4, a tub", parts.toy_brick, POURED,
               "nblug.org.uk, pick-a-brick cup: 101 poured into 950 cm3", per_m3=101 / 950e-6,
               spread=0.026, of_hull=True, tub=Tub(0.10, 950e-6 / (0.785398 * 0.10**2))),
    *(Experiment(f"rods, a = {a}", partial(parts.rod, a), DENSE, _RODS, 4.9 / a, spread=0.4 / a,
                 bodies=400)
      for a in (10, 20)),
]
