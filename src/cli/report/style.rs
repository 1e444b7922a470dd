//! Style sheet of a run's page.

/// Additions to the style sheet of a recording's page.
///
/// Colours represent roles. Colours within one figure differ in lightness, so they remain distinct
/// in greyscale.
pub(super) const MORE_STYLE: &str = "\
:root{--work:#1d4f91;--wait:#eceff3;--block:#f0a45a;--first:#8a8f98;--second:#1565c0;--third:#c2590a;
--sample:#1a1a1a;--fit:#1565c0;--pulse:#d97706;--limit:#b91c1c;--soft:#f5f7fa}
@media (prefers-color-scheme:dark){:root{--work:#7db7f2;--wait:#2c3138;--block:#b4631c;--first:#878d96;--second:#64b5f6;
--third:#ffb74d;--sample:#eeeeee;--fit:#64b5f6;--pulse:#ffb74d;--limit:#ff7b7b;--soft:#1a1d21}}
@media print{:root{--work:#1d4f91;--wait:#eceff3;--block:#f0a45a;--first:#8a8f98;--second:#1565c0;--third:#c2590a;
--sample:#1a1a1a;--fit:#1565c0;--pulse:#d97706;--limit:#b91c1c;--soft:#fff}}
h1.input{margin-top:34px;padding-top:22px;border-top:2px solid var(--rule)}
h2.group{font-size:18px;margin:26px 0 2px}
h2.group+.about{margin-bottom:8px}
.tiles{display:flex;flex-wrap:wrap;gap:10px;margin:12px 0 20px}
.tiles div{background:var(--soft);border:1px solid var(--rule);border-radius:6px;padding:8px 14px;min-width:86px}
.tiles b{display:block;font-size:20px;font-weight:600}.tiles span{color:var(--faint);font-size:13px}
.wide th,.wide td{text-align:right;padding:3px 8px;border-top:1px solid var(--rule);width:auto}
.wide th:first-child,.wide td:first-child{text-align:left}.wide{margin-bottom:14px}
figure .wide{font-size:13px;margin:8px 0 0}figure .wide th{font-weight:600}
figcaption{color:var(--faint);font-size:13px;margin-top:6px}
.notes{margin:4px 0;padding-left:20px}.notes li{margin:4px 0}
image{image-rendering:pixelated}image~.grid{stroke:var(--frame);stroke-opacity:.35}
.working{fill:var(--work)}.waiting{fill:var(--wait);stroke:var(--frame);stroke-width:.7}.blocked{fill:var(--block)}
polyline.waveforms{stroke:var(--first);stroke-width:2.4}polyline.returns{stroke:var(--second);stroke-width:1.6}
polyline.found{stroke:var(--third);stroke-width:1.6;stroke-dasharray:5 3}
.middle{stroke:var(--text);stroke-dasharray:5 4}.zero{stroke:var(--frame)}
.rod{stroke:var(--second);stroke-width:2}.span{stroke:var(--text)}.dot{fill:var(--second)}
polyline.scan{stroke:var(--second);stroke-width:.9}.under{opacity:.4}
.begin{fill:var(--third);stroke:var(--card)}
.sample{fill:var(--sample)}.left{fill:var(--card);stroke:var(--sample)}
.sat{fill:var(--card);stroke:var(--limit);stroke-width:1.5}.fit{stroke:var(--fit);stroke-width:2}
line.level{stroke:var(--faint);stroke-dasharray:5 4}.pulse{stroke:var(--pulse);stroke-width:1.2}
.peak{stroke:var(--pulse);stroke-dasharray:2 3}.one{fill:var(--fit);fill-opacity:.16}
.limit{stroke:var(--limit);stroke-dasharray:6 4}.stem{stroke:var(--first)}text.num{font-weight:600}
.legend{grid-column:1/-1;max-width:1000px}
.figures{align-items:start;margin-bottom:20px}.chain{margin:0 0 8px}
.job{margin-top:34px}.job td{font-size:13px}.job td:first-child{width:14%}section p{margin:4px 0}
@media print{h2.group{break-after:avoid}figure{break-inside:avoid}.tiles b{font-size:16px}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
";
