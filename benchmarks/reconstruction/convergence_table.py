"""results.md: every judged iteration of every variant; and the table of docs/reconstruction.md."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]
BEGIN, END = "<!-- convergence: begin -->", "<!-- convergence: end -->"
COLUMNS = (
    "| variant | iteration | work | residual | Q | RMS x / y / z | off focus x / y / z | replaced % "
    "| candidates % | s |"
)
RULE = "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
ALONE_COLUMNS = "| variant | iteration | residual | Q | centres off by x / y / z |"
ALONE_RULE = "|---|---:|---:|---:|---:|"


def three(values: list[float] | None) -> str:
    return "" if values is None else " / ".join(f"{v:.3f}" for v in values)


def pair_row(row: Row) -> str:
    replaced = f"{100 * row['replaced']:.1f}" if "replaced" in row else ""
    return (
        f"| {row['name']} | {row['round']} | {row['work']:g} | {row['residual']:.2f} | {row['q']:.3f} | "
        f"{three(row.get('error'))} | {three(row.get('off_focus'))} | {replaced} | {100 * row['voxels']:.1f} | "
        f"{row['seconds']:.1f} |"
    )


def alone_row(row: Row) -> str:
    return f"| {row['name']} | {row['round']} | {row['residual']:.2f} | {row['q']:.3f} | {three(row.get('centre'))} |"


def last_rounds(rows: list[Row]) -> list[Row]:
    """The last judged iteration of every variant."""
    return list({(row["name"], row["condition"]): row for row in rows}.values())


def table(rows: list[Row], condition: str) -> str:
    rows = [row for row in rows if row["condition"] == condition]
    if condition == "alone":
        return "\n".join([ALONE_COLUMNS, ALONE_RULE, *map(alone_row, last_rounds(rows))])
    return "\n".join([COLUMNS, RULE, *map(pair_row, rows)])


def page(rows: list[Row], noise: dict[str, float], conditions: dict[str, str]) -> str:
    """The whole of results.md. ``noise``: RMS counts of the pixels' noise; ``conditions``: what each one is."""
    parts = [
        "# Variants of MART on the same recordings",
        "Made by `convergence.py` beside this file; `results.json` holds every figure. `scene.py` says what is",
        "recorded, `cases.py` what is compared; docs/reconstruction.md says what it means.",
        "",
        "- Iteration 0 is the start. Work counts iterations over all views. Residual: RMS counts that the volume",
        "  leaves unexplained, after the iteration. Q against Gaussian particles 3 voxels wide, dead zone included.",
        "- RMS: errors of the displacements of all windows, in voxels, outliers replaced; off focus: of the windows",
        "  beyond |z| = 1.2 mm. Candidates: share of the voxels. Seconds: one frame's iterations, one thread, on a",
        "  machine that other work shared: a rough guide.",
    ]
    for name, says in conditions.items():
        parts += ["", f"## `{name}`: {says}", "", f"Noise of a pixel: {noise[name]:.1f} counts RMS.", ""]
        parts.append(table(rows, name))
    return "\n".join(parts) + "\n"


def by_iteration(rows: list[Row]) -> str:
    """RMS along z off focus after 1, 2, 3 and 5 iterations, and after the last where that is another."""
    value = {row["round"]: f"{row['off_focus'][2]:.3f}" for row in rows if "off_focus" in row}
    last = max(value, default=0)
    text = " / ".join(value.get(n, "-") for n in (1, 2, 3, 5)) if value else ""
    return text if last <= 5 else f"{text}; {last}: {value[last]}"


def summary(rows: list[Row]) -> str:
    """The table of docs/reconstruction.md: one line a variant."""
    lines = [
        "| variant | Q | RMS x / y / z | z off focus, iterations 1 / 2 / 3 / 5 | the same, dim | centre z, alone |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name in dict.fromkeys(row["name"] for row in rows):
        pair, dim, alone = (
            [row for row in rows if row["name"] == name and row["condition"] == condition]
            for condition in ("pair", "dim", "alone")
        )
        if pair[-1]["residual"] > pair[0]["residual"]:
            lines.append(f"| {name} | diverges |  |  |  |  |")
            continue
        centre = f"{alone[-1]['centre'][2]:.3f}" if alone else ""
        cells = name, f"{pair[-1]['q']:.3f}", three(pair[-1]["error"]), by_iteration(pair), by_iteration(dim), centre
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def into_page(text: str, table: str) -> str:
    """The page with what stands between its two markers replaced."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table}\n{END}{after}"
