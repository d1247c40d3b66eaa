"""The page of a report: HTML and its style, without scripts and without other files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

_COLOURS = {
    "finished": "#00714f",
    "stopped": "#0062a3",
    "interrupted": "#8a5a00",
    "failed": "#b3361b",
    "running": "#8a5a00",
}

_CSS = """
:root { color-scheme: light; --ink: #20262e; --quiet: #5b6672; --line: #e2e6ea; --wash: #f5f7f9; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: var(--ink); line-height: 1.5;
       font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }
header .kicker { color: var(--quiet); margin: 0; font-size: 15px; }
h1 { font-size: clamp(22px, 3.4vw, 32px); line-height: 1.25; margin: 6px 0 10px; font-weight: 650; }
h2 { font-size: 20px; margin: 44px 0 4px; padding-top: 14px; border-top: 1px solid var(--line); }
h2 + p { margin: 0 0 14px; color: var(--quiet); }
h3 { font-size: 15px; margin: 0 0 6px; font-weight: 600; }
.status { display: inline-block; color: #fff; border-radius: 4px;
  padding: 1px 9px; font-size: 14px; margin-right: 8px; }
.reason { color: var(--quiet); }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(118px, 1fr));
  gap: 10px; margin: 20px 0 0; padding: 0; }
.facts div { background: var(--wash); border-radius: 6px; padding: 10px 12px; }
.facts dt { color: var(--quiet); font-size: 13px; }
.facts dd { margin: 0; font-size: 18px; font-weight: 600; white-space: nowrap; }
.warnings { border-left: 4px solid #d9822b; background: #fdf6ec;
  margin: 22px 0 0; padding: 10px 16px; border-radius: 0 6px 6px 0; }
.warnings ul { margin: 4px 0; padding-left: 18px; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 430px), 1fr));
  gap: 26px 30px; align-items: start; }
figure { margin: 0; min-width: 0; max-width: 620px; }
figure img { width: 100%; height: auto; display: block; }
figcaption { color: var(--quiet); font-size: 13.5px; margin-top: 4px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 15px; width: 100%; max-width: 760px; }
th, td { text-align: left; padding: 5px 14px 5px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--quiet); font-weight: 500; font-size: 13px; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
th.n { text-align: right; }
pre, code { font: 13px/1.45 ui-monospace, "SF Mono", Menlo, "DejaVu Sans Mono", monospace; }
pre { background: var(--wash); padding: 12px 14px; border-radius: 6px; overflow-x: auto; margin: 8px 0; }
details { margin: 10px 0; }
summary { cursor: pointer; }
@media (max-width: 560px) { main { padding: 18px 14px 40px; } .facts dd { font-size: 16px; } }
@media print { details { display: none; } h2 { break-after: avoid; } figure { break-inside: avoid; } }
"""

TOOLS = (
    ("ParaView", "File, Open, results.h5, reader VTKHDF: material points (single precision, units as attributes)"),
    ("MDAnalysis", 'u.load_new("results.h5", format="H5MD"): atoms (H5MD, nm, ps)'),
    ("Python", "coordinator.results.Results(path), or h5py: everything"),
)

#: Events that a page lists.
_MOST_EVENTS = 20


def page(
    title: str,
    status: str,
    status_text: str,
    headline: str,
    reason: str,
    facts: Sequence[tuple[str, str]],
    warnings: Sequence[str],
    sections: Sequence[tuple[str, str, Sequence[str]]],
    events: Sequence[str],
    numbers: Sequence[tuple[str, str, str]],
    other: Sequence[tuple[str, str, str, str]],
    command: str,
    scene_text: str,
    versions: dict[str, str],
    seeds: dict[str, int],
    tools: Sequence[tuple[str, str]] = TOOLS,
) -> str:
    """Return the page. All texts are escaped here, except figures, which are HTML already.

    Parameters
    ----------
    title, status, status_text, headline, reason : str
        `status` picks the colour, `status_text` is shown.
    facts : sequence of (value, label)
    warnings : sequence of str
    sections : sequence of (title, sentence, figures as HTML)
    events : sequence of str
        In order; of many the first and the last are shown.
    numbers : sequence of (what, value, unit)
    other : sequence of (name, meaning, value, unit)
    command, scene_text : str
    versions : dict of str to str
    seeds : dict of str to int
    tools : sequence of (tool, how)
        That open the results.
    """
    parts = [
        f'<p class="kicker">{escape(title)}</p>',
        f"<h1>{escape(headline)}</h1>",
        f'<p><span class="status" style="background:{_COLOURS.get(status, "#5b6672")}">{escape(status_text)}</span>'
        f'<span class="reason">{escape(reason)}</span></p>',
        '<dl class="facts">'
        + "".join(f"<div><dd>{escape(value)}</dd><dt>{escape(label)}</dt></div>" for value, label in facts)
        + "</dl>",
    ]
    head = f"<header>{''.join(parts)}</header>"
    body = [head]
    if warnings:
        items = "".join(f"<li>{escape(text)}</li>" for text in warnings)
        body.append(f'<div class="warnings"><strong>Read before use</strong><ul>{items}</ul></div>')
    for name, sentence, figures in sections:
        text = f"<p>{escape(sentence)}</p>" if sentence else "<p></p>"
        body.append(f'<section><h2>{escape(name)}</h2>{text}<div class="figures">{"".join(figures)}</div></section>')
    if events:
        shown = [*events[:_MOST_EVENTS], "...", events[-1]] if len(events) > _MOST_EVENTS + 1 else list(events)
        items = "".join(f"<li>{escape(text)}</li>" for text in shown)
        body.append(f"<h2>Events</h2><p>All {len(events)} are in results.h5.</p><ol>{items}</ol>")
    if numbers:
        body.append(f"<h2>Key numbers</h2><p></p>{_table(('', 'value', 'unit'), numbers, (1,))}")
    if other:
        table = _table(("series", "meaning", "last value", "unit"), other, (2,))
        body.append(f"<h2>Other series</h2><p>Not drawn above; all are in results.h5.</p>{table}")
    body.append("<h2>Do it again</h2><p>The same versions and seeds give the same run.</p>")
    body.append(f"<pre>{escape(command)}</pre>")
    body.append(f"<details><summary>Scene file</summary><pre>{escape(scene_text)}</pre></details>")
    rows = [(name, version, "") for name, version in versions.items()]
    rows += [(f"seed: {name}", str(seed), "") for name, seed in seeds.items()]
    body.append(_table(("package", "version", ""), rows, ()))
    body.append(f"<h2>Open the results</h2><p></p>{_table(('tool', 'how'), tools, ())}")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_CSS}</style></head><body><main>{''.join(body)}</main></body></html>\n"
    )


def _table(head: Iterable[str], rows: Iterable[Sequence[str]], numeric: tuple[int, ...]) -> str:
    def cells(tag: str, row: Iterable[str]) -> str:
        return "".join(
            f"<{tag}{' class=n' if k in numeric else ''}>{escape(cell)}</{tag}>" for k, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{cells("th", head)}</tr>{body}</table></div>'
