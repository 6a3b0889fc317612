"""The report's style sheet: light and dark, figures always on white."""

STYLE = """
:root { color-scheme: light dark; --ink: #1f2933; --soft: #5b6875; --line: #dde2e7; --paper: #fff; --tint: #f4f6f8;
        --accent: #1f6fb2; --warn: #fdf3e3; --warn-line: #d9822b; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ec; --soft: #9aa7b4; --line: #36414c; --paper: #171c21; --tint: #20272e; --accent: #6db3f2;
          --warn: #33291a; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 2rem 1.5rem 3rem; background: var(--paper); color: var(--ink);
       font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 0 0 .3rem; }
section { margin-top: 2.2rem; }
section > p { margin: 0 0 .7rem; color: var(--soft); max-width: 48rem; }
header dl { display: flex; flex-wrap: wrap; margin: 0; border: 1px solid var(--line); border-radius: 6px;
            overflow: hidden; }
header dl div { flex: 1 1 auto; padding: .6rem 1rem; background: var(--tint); }
dt { color: var(--soft); font-size: .8rem; }
dd { margin: 0; font-size: 1.1rem; font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: 0; padding: .5rem; background: #fff; border: 1px solid var(--line); border-radius: 6px; }
figure img { display: block; width: 100%; height: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; max-width: 100%; }
th, td { text-align: left; padding: .25rem 1.5rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top;
         font-weight: 400; overflow-wrap: anywhere; }
thead th, thead td { color: var(--soft); font-size: .8rem; }
tbody th { white-space: nowrap; font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .87rem; }
.bar { width: 16rem; vertical-align: middle; }
.bar i { display: block; height: .55rem; background: var(--accent); border-radius: 2px; }
.warnings { background: var(--warn); border-left: 4px solid var(--warn-line); border-radius: 4px;
            padding: .8rem 1.2rem; }
.warnings ul { margin: .3rem 0 0; padding-left: 1.1rem; }
.fine { margin-top: 1.5rem; color: var(--soft); }
pre { background: var(--tint); border-radius: 6px; padding: 1rem; overflow-x: auto; font-size: .85rem;
      line-height: 1.4; }
summary { cursor: pointer; color: var(--accent); }
footer { margin-top: 3rem; padding-top: .8rem; border-top: 1px solid var(--line); color: var(--soft);
         font-size: .85rem; }
"""
