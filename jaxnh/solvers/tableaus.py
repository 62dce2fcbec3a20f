"""The explicit Runge–Kutta methods there are: tables of coefficients and their sources."""

from __future__ import annotations

from collections.abc import Sequence

import diffrax
import numpy as np
from diffrax import ButcherTableau

from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta


def write_out(tableau: ButcherTableau, order: int, name: str, source: str) -> WrittenOutRungeKutta:
    """The written-out solver of an explicit diffrax tableau."""
    rows = ((), *(tuple(np.asarray(row).tolist()) for row in tableau.a_lower))
    return WrittenOutRungeKutta(
        a=rows,
        b=tuple(np.asarray(tableau.b_sol).tolist()),
        b_error=tuple(np.asarray(tableau.b_error).tolist()),
        c=(0.0, *np.asarray(tableau.c).tolist()),
        convergence_order=order,
        name=name,
        source=source,
    )


def _solver_from_rows(
    rows: Sequence[Sequence[float]],
    b: Sequence[float],
    embedded: Sequence[float],
    order: int,
    name: str,
    source: str,
) -> WrittenOutRungeKutta:
    """The solver of rows of a tableau from the second stage on, and the weights of its two solutions."""
    return WrittenOutRungeKutta(
        a=((), *(tuple(row) for row in rows)),
        b=tuple(b),
        b_error=tuple(one - other for one, other in zip(b, embedded, strict=True)),
        c=(0.0, *(float(np.sum(row)) for row in rows)),
        convergence_order=order,
        name=name,
        source=source,
    )


dopri8 = write_out(
    diffrax.Dopri8.tableau, 8, "dopri8", "Prince and Dormand, J. Comput. Appl. Math. 7 (1981) 67, via diffrax"
)
"""Dormand–Prince 8(7), thirteen stages and one more for the error estimate."""

tsit5 = write_out(diffrax.Tsit5.tableau, 5, "tsit5", "Tsitouras, Comput. Math. Appl. 62 (2011) 770, via diffrax")
"""Tsitouras 5(4), six stages and one more for the error estimate."""

dopri5 = write_out(
    diffrax.Dopri5.tableau, 5, "dopri5", "Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, via diffrax"
)
"""Dormand–Prince 5(4), six stages and one more for the error estimate."""

tsitouras_papakostas8 = _solver_from_rows(
    rows=(
        (0.06338028169014084,),
        (0.019438980427336498, 0.08334896544902781),
        (0.038545479703636615, 0.0, 0.11563643911090984),
        (0.39436557770112496, 0.0, -1.4818719321673373, 1.4751032536910185),
        (0.045994489107698204, 0.0, 0.0, 0.23235070626395474, 0.18740822928588133),
        (0.06005228953244051, 0.0, 0.0, 0.11220383194636774, -0.03357232951906142, 0.016721613445658576),
        (-1.5733292732086859, 0.0, 0.0, -1.3167087730223663, -11.723515296181773, 9.107825028173874, 6.512820512820513),
        (
            -0.48107625624391254,
            0.0,
            0.0,
            -6.6506103607463904,
            -4.530206099782572,
            3.894414525020157,
            8.634217645525526,
            0.009401624788681498,
        ),
        (
            -0.7754121446230569,
            0.0,
            0.0,
            -7.996604718235832,
            -6.726558607230182,
            5.532184454327406,
            10.89757332024991,
            0.020091650280045396,
            -0.039186042680376856,
        ),
        (
            -1.1896363245449992,
            0.0,
            0.0,
            -7.128368483301214,
            -9.53722789710108,
            7.574470108980868,
            11.267486382070919,
            0.051009801223058315,
            0.08019413469508256,
            -0.15819617839847347,
        ),
        (
            -0.39200039047127266,
            0.0,
            0.0,
            3.916659042493856,
            -2.8017459289080557,
            2.441204566481742,
            -2.4183655778824718,
            -0.33943326290032927,
            0.19496450383103364,
            -0.19437176762508154,
            0.5930888149805791,
        ),
        (
            -1.4847063081291894,
            0.0,
            0.0,
            -2.390723588981498,
            -11.184306772840532,
            8.720804667459817,
            7.33673830753461,
            0.01289874999394761,
            0.042583289842657704,
            -0.05328834487981156,
            0.0,
            0.0,
        ),
    ),
    b=(
        0.04441161093250152,
        0.0,
        0.0,
        0.0,
        0.0,
        0.35395063113733116,
        0.2485219684184965,
        -0.3326913171720666,
        1.921248828652836,
        -2.7317783000882523,
        1.4012004409899175,
        0.0951361371292365,
        0.0,
    ),
    embedded=(
        0.044484201850329544,
        0.0,
        0.0,
        0.0,
        0.0,
        0.35502352274458154,
        0.24825530158391707,
        -2.4242252962684616,
        1.5999301534099692,
        -1.8107646286929684,
        0.0,
        0.0,
        2.9872967453726327,
    ),
    order=8,
    name="tsitouras_papakostas8",
    source="Tsitouras and Papakostas, SIAM J. Sci. Comput. 20 (1999) 2067, pair of orders eight and seven",
)
"""Tsitouras–Papakostas 8(7), twelve stages and one more for the error estimate."""

verner9 = _solver_from_rows(
    rows=(
        (0.03462,),
        (-0.038933543885728734, 0.13595789452450918),
        (0.03638413148954267, 0.0, 0.109152394468628),
        (2.02576391439397, 0.0, -7.638023836496292, 6.173259922102322),
        (0.05112275589406061, 0.0, 0.0, 0.17708237945550215, 0.0008027762409222502),
        (0.13160063579752163, 0.0, 0.0, -0.29572762526696367, 0.08781378035642952, 0.6213052975225275),
        (0.07166666666666667, 0.0, 0.0, 0.0, 0.0, 0.33055335789153195, 0.24277997544180138),
        (0.071806640625, 0.0, 0.0, 0.0, 0.0, 0.3294380283228177, 0.11651900292718229, -0.034013671875),
        (
            0.04836757646340647,
            0.0,
            0.0,
            0.0,
            0.0,
            0.03928989925676164,
            0.10547409458903446,
            -0.021438652846483126,
            -0.10412291746271944,
        ),
        (
            -0.026645614872014785,
            0.0,
            0.0,
            0.0,
            0.0,
            0.03333333333333333,
            -0.1631072244872467,
            0.033960816841277615,
            0.1572319413814626,
            0.21522674780318796,
        ),
        (
            0.036890092487086225,
            0.0,
            0.0,
            0.0,
            0.0,
            -0.1465181576725543,
            0.22425777681720244,
            0.022944057170660725,
            -0.003585005290572876,
            0.08669223316444385,
            0.43838406519683376,
        ),
        (
            -0.48660122151133406,
            0.0,
            0.0,
            0.0,
            0.0,
            -6.304602650282853,
            -0.2812456182894726,
            -2.6790192362198493,
            0.5188156639241576,
            1.3653531876033418,
            5.8850910885039465,
            2.8028087862720628,
        ),
        (
            0.41853674577534716,
            0.0,
            0.0,
            0.0,
            0.0,
            6.724547581906459,
            -0.4254442801646118,
            3.3432791530012658,
            0.6170816631175378,
            -0.9299661239399328,
            -6.099948804751011,
            -3.002206187889399,
            0.2553202529443446,
        ),
        (
            -0.7793740861228846,
            0.0,
            0.0,
            0.0,
            0.0,
            -13.937342538107776,
            1.2520488533793572,
            -14.69150040801687,
            -0.4947050585331417,
            2.2429749091462368,
            13.367893803828643,
            14.396650486650687,
            -0.79758133317768,
            0.4409353709534278,
        ),
        (
            2.0580513374668863,
            0.0,
            0.0,
            0.0,
            0.0,
            22.357937727968032,
            0.9094981099755634,
            35.89110098240264,
            -3.4425150276244536,
            -4.8654813580363685,
            -18.909803813543427,
            -34.26354448030452,
            1.2647565216956427,
            0.0,
            0.0,
        ),
    ),
    b=(
        0.014611976858423152,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        -0.3915211862331339,
        0.23109325002895065,
        0.12747667699928525,
        0.2246434176204158,
        0.5684352689748513,
        0.058258715572158275,
        0.13643174034822156,
        0.030570139830827976,
        0.0,
    ),
    embedded=(
        0.01996996514886773,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        2.19149930494933,
        0.08857071848208438,
        0.11405602348659656,
        0.2533163805345107,
        -2.056564386240941,
        0.340809679901312,
        0.0,
        0.0,
        0.048342313738239585,
    ),
    order=9,
    name="verner9",
    source="Verner, Numer. Algorithms 53 (2010) 383, efficient pair of orders nine and eight",
)
"""Verner's efficient 9(8), fifteen stages and one more for the error estimate."""

RUNGE_KUTTA: dict[str, WrittenOutRungeKutta] = {
    s.name: s for s in (tsit5, dopri5, dopri8, tsitouras_papakostas8, verner9)
}
"""Written-out Runge–Kutta methods by their name in configs."""
