"""Solvers by their name in configs. The methods themselves are in `solvers`, which imports JAX."""

SPLITTINGS = ("strang2", "blanes_moan4", "blanes_moan6", "processed6", "kahan_li8", "sofroniou_spaletta10")
"""Isokinetic splittings, in rising order."""

PROCESSED = ("processed6",)
"""Splittings that are accurate at the end of many steps alone, and not after each."""

RUNGE_KUTTA = ("tsit5", "dopri5", "dopri8", "tsitouras_papakostas8", "verner9")

NYSTROM = ("nystrom8",)

ADAPTIVE = ("rodas5p", *(f"adaptive_{name}" for name in RUNGE_KUTTA))
"""Solvers with steps of a lane's own; the first is linearly implicit."""

SOLVERS = (*SPLITTINGS, *RUNGE_KUTTA, *NYSTROM, *ADAPTIVE)
