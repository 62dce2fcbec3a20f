"""The isokinetic splittings there are: tables of coefficients and their sources."""

from __future__ import annotations

import numpy as np

from jaxnh.solvers.isokinetic import IsokineticSplitting


def _palindrome(half: tuple[float, ...]) -> tuple[float, ...]:
    """half, then what is missing to one, then half backwards: an odd number of coefficients."""
    return (*half, 1.0 - 2.0 * sum(half), *half[::-1])


def _mirror(half: tuple[float, ...]) -> tuple[float, ...]:
    """half, what is missing to one half, and the same backwards: an even number of coefficients."""
    whole = (*half, 0.5 - sum(half))
    return (*whole, *whole[::-1])


def _with_zero_sum(most: tuple[float, ...]) -> tuple[float, ...]:
    """most, and what makes the sum zero."""
    return (*most, -sum(most))


def _strang_composition(name: str, order: int, source: str, half: tuple[float, ...]) -> IsokineticSplitting:
    """A symmetric composition of Strang steps: drift γ/2, kick γ, drift γ/2, for each γ; neighbouring drifts join."""
    gammas = np.array(_palindrome(half))
    drifts = 0.5 * (np.append(gammas, 0.0) + np.append(0.0, gammas))
    return IsokineticSplitting(tuple(drifts.tolist()), tuple(gammas.tolist()), order, name, source)


_STRANG_2 = _strang_composition("strang2", 2, "Strang, SIAM J. Numer. Anal. 5 (1968) 506", ())

_BLANES_MOAN_4 = IsokineticSplitting(
    drifts=_palindrome((0.0792036964311957, 0.353172906049774, -0.0420650803577195)),
    kicks=_mirror((0.209515106613362, -0.143851773179818)),
    convergence_order=4,
    name="blanes_moan4",
    source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, S6 of order four",
)

_BLANES_MOAN_6 = IsokineticSplitting(
    drifts=_palindrome(
        (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780)
    ),
    kicks=_mirror((0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175)),
    convergence_order=6,
    name="blanes_moan6",
    source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, S10 of order six",
)

# fmt: off
_PROCESSED_6 = IsokineticSplitting(
    drifts=_palindrome(
        (
            0.412429989953716, -0.14085938147470947, -0.19742665430330528, 0.2879606490331444,
        )
    ),
    kicks=_mirror((0.0254067971377701, -0.09139409858407993, 0.288972648972962)),
    convergence_order=6,
    name="processed6",
    source="this project, sweeps/studies/compositions.py: processed, its errors of degree seven weighed by this flow",
    processor=(
        _with_zero_sum(
            (
                0.1475826646887791, 0.474068021771032, -0.08438441732829983, 0.14079119986465405, -0.2059338467530925,
                -0.4923785323422904, 0.16691883018778114, -0.0005462397088854907, -0.1973716617699709,
                0.32315406564130034, 0.17976096110595616, 0.11688742658045384, 0.034650059341028536,
                -0.5507044862565134,
            )
        ),
        _with_zero_sum(
            (
                0.26643175261088076, -0.2206137646409321, 0.25371314748727825, 0.030417992851457375,
                -0.12879799573715492, -0.38869699381964884, -0.476671012570288, 0.5108381614144392, 0.3254936032091319,
                0.11810006197018574, -0.13596945893112058, -0.18010895509043445, 0.2679299394922897,
            )
        ),
    ),
)
# fmt: on

# fmt: off
_KAHAN_LI_8 = _strang_composition(
    "kahan_li8",
    8,
    "Kahan and Li, Math. Comp. 66 (1997) 1089, s17odr8a",
    (
        0.13020248308889008087881763, 0.56116298177510838456196441, -0.38947496264484728640807860,
        0.15884190655515560089621075, -0.39590389413323757733623154, 0.18453964097831570709183254,
        0.25837438768632204729397911, 0.29501172360931029887096624,
    ),
)
# fmt: on

# fmt: off
_SOFRONIOU_SPALETTA_10 = _strang_composition(
    "sofroniou_spaletta10",
    10,
    "Sofroniou and Spaletta, Optim. Methods Softw. 20 (2005) 597, 35 stages",
    (
        0.07879572252168641926390768, 0.31309610341510852776481247, 0.02791838323507806610952027,
        -0.22959284159390709415121340, 0.13096206107716486317465686, -0.26973340565451071434460973,
        0.07497334315589143566613711, 0.11199342399981020488957508, 0.36613344954622675119314812,
        -0.39910563013603589787862981, 0.10308739852747107731580277, 0.41143087395589023782070412,
        -0.00486636058313526176219566, -0.39203335370863990644808194, 0.05194250296244964703718290,
        0.05066509075992449633587434, 0.04967437063972987905456880,
    ),
)
# fmt: on

SPLITTINGS: dict[str, IsokineticSplitting] = {
    s.name: s for s in (_STRANG_2, _BLANES_MOAN_4, _BLANES_MOAN_6, _PROCESSED_6, _KAHAN_LI_8, _SOFRONIOU_SPALETTA_10)
}
"""Splittings by their name in configs, in rising order."""
