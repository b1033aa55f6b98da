"""The HTML around the report of `omniman reproduce all`: one column on a screen, A4 on paper."""

from string import Template

PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>omniman: measured against published</title>
<style>
:root { --ink: #1f2933; --grey: #5f6b7a; --faint: #dde2e8; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.5rem 3rem; max-width: 62rem; color: var(--ink);
  background: #fff; font: 14px/1.45 system-ui, -apple-system, "Segoe UI", "DejaVu Sans",
  sans-serif; }
h1 { font-size: 1.7em; margin: 0 0 .2em; letter-spacing: -.01em; }
h2 { font-size: 1.1em; margin: 2em 0 .5em; break-after: avoid; }
p { margin: .4em 0; }
.meta, figcaption, small { color: var(--grey); }
.meta { font-size: .9em; }
.counts { font-weight: 600; margin-top: .8em; }
.warning { border-left: 4px solid #d9820f; padding: .3em .8em; background: #fdf6ea; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .45em .7em .45em 0;
  border-bottom: 1px solid var(--faint); }
thead th { border-bottom: 2px solid var(--ink); font-size: .9em; }
tbody th { font-weight: 600; }
tr { break-inside: avoid; }
small { display: block; font-size: .82em; font-weight: 400; line-height: 1.35; }
.compare th:first-child { width: 21%; }
.compare td:nth-child(2), .compare td:nth-child(3) { width: 35%; }
.experiments th, .experiments td { white-space: nowrap; }
.own th { width: 36%; }
.verdict { display: inline-block; white-space: nowrap; font-size: .85em; font-weight: 600;
  padding: .05em .6em; border-radius: 1em; border: 1px solid currentColor; }
.agrees { color: #0b6b36; background: #e9f6ee; }
.partly { color: #8a5300; background: #fdf4e3; }
.differs { color: #b01c1c; background: #fdecec; }
.no-number, .not-measured { color: var(--grey); background: #f5f7f9; }
.figures { display: grid; gap: 1.6em; }
figure { margin: 0; break-inside: avoid; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .9em; margin-top: .2em; }
figcaption b { color: var(--ink); }
@page { size: A4; margin: 11mm 12mm; }
@media print {
  body { padding: 0; max-width: none; font-size: 7.2pt; line-height: 1.28; }
  h1 { font-size: 14pt; }
  h2 { margin: .9em 0 .3em; }
  th, td { padding: .15em .5em .15em 0; }
  .tables { display: grid; grid-template-columns: 13fr 10fr; gap: 0 6mm; }
  .verdict, .warning { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .figures { grid-template-columns: repeat(3, 1fr); gap: 2mm 4mm; align-items: end; }
  figure img { width: auto; max-width: 100%; max-height: 44mm; margin: 0 auto; }
}
</style>
</head>
<body>
<h1>Measured against published</h1>
<p class="meta">omniman reproduce all · $date · experiments took $took<br>$versions<br>$machine</p>
$warning
<p>Experiments of two papers, repeated on the simulated robots of this package. <b>CCTA 2017</b>:
Röhrig, Heß, Künemund, <i>Motion Controller Design for a Mecanum Wheeled Mobile Manipulator</i>.
<b>MPC 2021</b>: Moreno-Caireta, Celaya, Ros, <i>Model Predictive Control for a Mecanum-wheeled
Robot Navigating among Obstacles</i>. The papers print curves, pictures and claims, hardly a
number; parameters of the robots, sizes of the scenes and weights are not published, so those here
are this package's own, and so is the rule of what counts as agreement, stated in each row. A
simulation that agrees is no proof for a real robot.</p>
<p class="counts">$counts</p>
<table class="compare">
<thead><tr><th>What, where</th><th>Published</th><th>Measured</th><th>Verdict</th></tr></thead>
<tbody>
$comparisons
</tbody>
</table>
<div class="tables">
<section>
<h2>Experiments</h2>
<table class="experiments">
<thead><tr><th>Experiment</th><th>Own aims</th><th>Size</th><th>Drives</th><th>Robot</th>
<th>Seed</th><th>Took</th><th>Made (UTC)</th></tr></thead>
<tbody>
$experiments
</tbody>
</table>
$also
</section>
$own
</div>
<h2>Figures</h2>
<div class="figures">
$figures
</div>
</body>
</html>
""")
"""Every field is HTML already."""
