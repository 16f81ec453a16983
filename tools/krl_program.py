"""The KRL program of each variant in krl/; `make_krl.py` writes it."""

from __future__ import annotations

from krl_variants import SPAN, Variant

from construction_twin.rsi.make import NOTICE


def program(variant: Variant, rsi41: bool) -> str:
    """Return the KRL program of a context."""
    context = variant.name if rsi41 else f"{variant.name}.rsi"
    body = _read_only_body() if variant.read_only else _motion_body(variant, rsi41)
    limits = rsi41 and not variant.read_only
    lines = [
        "&ACCESS RVP",
        "&REL 1",
        f"&COMMENT construction_twin, RSI {'4.1 and later' if rsi41 else '3.x'}: not tried on a controller",
        f"DEF {variant.name}()",
        *(f"; {line}" for line in _heading(variant, rsi41)),
        "DECL INT ret, container",
        "",
        ";FOLD INI",
        "  ;FOLD BASISTECH INI",
        "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()",
        "    INTERRUPT ON 3",
        "    BAS(#INITMOV, 0)",
        "  ;ENDFOLD (BASISTECH INI)",
        ";ENDFOLD (INI)",
        "",
        "; block coincidence: a motion to where the arm already stands",
        "PTP $AXIS_ACT_MEAS",
        "",
        f'ret = RSI_CREATE("{context}", container, TRUE)',
        *_check("ret"),
        *(["", "ctwin_limits(container)"] if limits else []),
        "",
        *body,
        "",
        *_off(variant),
        "ret = RSI_OFF()",
        *_check("ret"),
        "ret = RSI_DELETE(container)",
        *_check("ret"),
        "END",
    ]
    if limits:
        lines += ["", *_limits(variant)]
    return "\n".join(lines) + "\n"


def _heading(variant: Variant, rsi41: bool) -> list[str]:
    files = f"{variant.name}.rsix" if rsi41 else f"{variant.name}.rsi, .rsi.diagram and .rsi.xml"
    lines = [
        NOTICE,
        f"Needs {files}, and {variant.ethernet}, in Config/User/Common/SensorInterface.",
        "Start rsi_gateway on the PC first: the exchange begins with RSI_ON.",
    ]
    if variant.read_only:
        return [*lines, "The controller only reports (ONLYSEND TRUE): nothing on the PC can move the arm."]
    lines.append("The PC moves the arm from RSI_MOVECORR on. First runs: T1, commissioning mode of the gateway.")
    return [*lines, *_tool_lines(variant)]


def _tool_lines(variant: Variant) -> list[str]:
    """Return what the heading says of the tool."""
    if not variant.outputs:
        return []
    places = [f"{name} $OUT[{variant.first_out + n}]" for n, name in enumerate(variant.outputs)]
    places += [f"{name} $IN[{variant.first_in + n}]" for n, name in enumerate(variant.inputs)]
    return [
        f"Tool: {', '.join(places)}.",
        "RSI_ON changes no output: the context sets and resets them on edges only, and only while Set.Enable is 1.",
        "$LOAD must hold the tool with the heaviest part that it may carry (`load` of the tool file): set it before this program.",
    ]


def _off(variant: Variant) -> list[str]:
    """Return what switches off the outputs that are off without RSI."""
    numbers = [variant.first_out + n for n, held in enumerate(variant.outputs.values()) if not held]
    return [*(f"$OUT[{number}] = FALSE" for number in numbers), *([""] if numbers else [])]


def _check(name: str) -> list[str]:
    return [f"IF ({name} <> RSIOK) THEN", "  HALT", "ENDIF"]


def _motion_body(variant: Variant, rsi41: bool) -> list[str]:
    note = (
        "the bounds of the corrections are set from the soft limits above"
        if rsi41
        else "bounds of the corrections: wide ones in the context; soft limits and the gateway's own range hold"
    )
    return [
        f"; {note}",
        "; absolute: a correction is the offset from this pose, and a missed reply holds it (HOLDON 1)",
        "ret = RSI_ON(#ABSOLUTE, #IPO_FAST)",
        *_check("ret"),
        "",
        "; returns when the gateway sends Stop 1, at rest",
        "RSI_MOVECORR()",
    ]


def _read_only_body() -> list[str]:
    return [
        "ret = RSI_ON(#ABSOLUTE, #IPO_FAST)",
        *_check("ret"),
        "",
        "; no RSI_MOVECORR: with ONLYSEND nothing corrects. Put your own motions in place of the loop.",
        "LOOP",
        "  WAIT SEC 1.0",
        "ENDLOOP",
    ]


def _limits(variant: Variant) -> list[str]:
    axes: list[tuple[str, int, str]] = [(axis, index, "AxisCorr_1") for index, axis in enumerate(SPAN, 1)]
    if variant.external:
        axes.append(("E1", 7, "AxisCorrExt_1"))
    lines = [
        "DEF ctwin_limits(container :IN)",
        "; From here to the soft limits, per axis: AXISCORR would clamp a larger correction without a message.",
        "DECL INT container, ret",
        "DECL REAL below, above, most",
        "",
    ]
    for axis, index, name in axes:
        lines += [
            f"below = $SOFTN_END[{index}] - $AXIS_ACT_MEAS.{axis}",
            f"above = $SOFTP_END[{index}] - $AXIS_ACT_MEAS.{axis}",
            "most = above",
            "IF (-below > above) THEN",
            "  most = -below",
            "ENDIF",
            f'ret = RSI_SetPublicPar(container, "{name}", "LowerLim{axis}", below)',
            *_check("ret"),
            f'ret = RSI_SetPublicPar(container, "{name}", "UpperLim{axis}", above)',
            *_check("ret"),
            f'ret = RSI_SetPublicPar(container, "AxisCorrMon_1", "Max{axis}", most)',
            *_check("ret"),
            "",
        ]
    return [*lines, "END"]
