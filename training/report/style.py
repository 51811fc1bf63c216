"""The style sheet of report.html; line lengths are those of CSS."""

# ruff: noqa: E501
STYLE = """
:root { --ink: #1d2433; --soft: #667085; --line: #e3e6ec; --paper: #ffffff; --wash: #f5f6f9; --accent: #2f6fb5; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--wash); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { margin: 0 0 16px; font-size: 26px; letter-spacing: -0.01em; }
.about { margin: -8px 0 18px; max-width: 92ch; }
h2 { margin: 0 0 14px; font-size: 17px; }
h3 { margin: 16px 0 8px; font-size: 14px; font-weight: 600; overflow-wrap: anywhere; }
h2 + h3 { margin-top: 0; }
section, header { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: 22px 24px; margin-bottom: 18px; }
dl { display: flex; flex-wrap: wrap; gap: 14px 40px; margin: 0; }
dt { color: var(--soft); font-size: 12.5px; overflow-wrap: anywhere; }
dd { margin: 0; font-size: 19px; font-weight: 600; font-variant-numeric: tabular-nums; }
small { color: var(--soft); font-size: 12px; font-weight: 400; }
.pictures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 24px; }
.stack { display: grid; }
.stack img { grid-area: 1 / 1; }
.stack img:nth-child(2) { clip-path: inset(0 calc(100% - var(--at) * 1%) 0 0); }
.stack img:nth-child(3) { clip-path: inset(0 calc(200% - var(--at) * 1%) 0 0); }
.compare input { width: 100%; margin: 10px 0 0; accent-color: var(--accent); }
.ends { display: flex; justify-content: space-between; font-size: 13px; font-weight: 600; font-variant-numeric: tabular-nums; }
.bar { height: 12px; margin: 12px 0 3px; border-radius: 3px; }
.note { margin: 14px 0 0; color: var(--soft); font-size: 13.5px; max-width: 92ch; }
summary { cursor: pointer; font-size: 17px; font-weight: 700; }
details pre { margin-top: 14px; }
.pictures.textures { grid-template-columns: repeat(3, minmax(0, 260px)); }
figure { margin: 0; }
img { display: block; width: 100%; border-radius: 5px; background: #000; image-rendering: pixelated; }
figcaption { margin-top: 6px; font-weight: 600; font-size: 13.5px; }
table { border-collapse: collapse; width: 100%; display: block; overflow-x: auto; }
th, td { text-align: left; padding: 8px 22px 8px 0; border-bottom: 1px solid var(--line); vertical-align: top; font-weight: 400; white-space: nowrap; }
tr:last-child > * { border-bottom: 0; }
tr:first-child > th { color: var(--soft); font-size: 12.5px; }
table.narrow tr > th { color: var(--soft); font-size: 14px; }
th small { display: block; }
.number { font-variant-numeric: tabular-nums; }
.swatch { display: inline-block; width: 15px; height: 15px; margin-right: 9px; border-radius: 3px; vertical-align: -2px; border: 1px solid rgba(0, 0, 0, 0.18); }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 22px 28px; }
svg { display: block; width: 100%; height: auto; margin-top: 4px; }
svg text { fill: var(--soft); font-size: 11.5px; font-family: inherit; font-variant-numeric: tabular-nums; }
svg .grid { stroke: var(--line); stroke-width: 1; }
svg .axis { stroke: #b9bfca; stroke-width: 1; }
svg .curve { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
svg .goal { fill: none; stroke-width: 1.3; stroke-dasharray: 5 4; opacity: 0.75; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 18px; font-size: 12.5px; color: var(--soft); padding-left: 58px; }
.legend i { display: inline-block; width: 16px; height: 3px; border-radius: 2px; margin-right: 7px; vertical-align: 3px; }
.legend i.dashed { height: 0; border-top: 2px dashed #98a0ae; border-radius: 0; }
pre { margin: 0; padding: 14px 16px; background: var(--wash); border-radius: 6px; font: 12.5px/1.55 ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; white-space: pre-wrap; overflow-wrap: anywhere; }
@media (max-width: 700px) { .charts, .pictures, .pictures.textures { grid-template-columns: 1fr; } main { padding: 16px 10px 40px; } }
@media (max-width: 700px) {
  section, header { padding: 16px 12px; }
  th, td { white-space: normal; overflow-wrap: anywhere; padding-right: 10px; }
  .charts { grid-template-columns: minmax(0, 1fr); }
  .parameters, .parameters tbody, .parameters tr, .parameters th, .parameters td { display: block; }
  .parameters tr:first-child { display: none; }
  .parameters th { border-bottom: 0; font-weight: 600; padding-bottom: 2px; }
  .parameters td { display: flex; justify-content: space-between; gap: 12px; border-bottom: 0; padding: 2px 0; text-align: right; }
  .parameters td:last-child { border-bottom: 1px solid var(--line); padding-bottom: 8px; }
  .parameters td::before { content: attr(data-head); color: var(--soft); text-align: left; }
}
@media print { .stack { gap: 8px; } .stack img { grid-area: auto; clip-path: none !important; } .compare input { display: none; } }
"""
