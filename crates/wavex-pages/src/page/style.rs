//! Style sheets of the pages of recordings and runs.

/// Style sheet: follows the system's light or dark theme; prints black on white.
pub(super) const STYLE: &str = "\
:root{color-scheme:light dark;--page:#fff;--card:#fff;--text:#222;--faint:#666;--rule:#d8d8d8;--grid:#e8e8e8;
--frame:#888;--bar:#3f7fc1;--low:#1565c0;--high:#c2590a}
@media (prefers-color-scheme:dark){:root{--page:#121417;--card:#1a1d21;--text:#ddd;--faint:#9a9a9a;--rule:#33383f;
--grid:#2b2f36;--frame:#777;--bar:#4f8fd0;--low:#64b5f6;--high:#ffb74d}}
@media print{:root{--page:#fff;--card:#fff;--text:#000;--faint:#444;--rule:#bbb;--grid:#ddd;--frame:#777;--bar:#3f7fc1;
--low:#1565c0;--high:#c2590a}}
body{margin:0 auto;max-width:1220px;padding:24px 20px 40px;background:var(--page);color:var(--text);
font:15px/1.45 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif}
h1{font-size:24px;margin:0 0 2px;overflow-wrap:anywhere}h2{font-size:16px;margin:0 0 6px}
h3{font-size:14px;font-weight:600;margin:0 0 4px}.about{color:var(--faint);margin:0 0 18px}
a{color:var(--low)}a:focus-visible,.scroll:focus-visible,summary:focus-visible{outline:2px solid var(--low);outline-offset:2px}
.sections{columns:2;column-gap:32px}section{break-inside:avoid;padding:0 0 18px}
table{border-collapse:collapse;width:100%}td{border-top:1px solid var(--rule);padding:3px 0;vertical-align:top;
overflow-wrap:anywhere}td:first-child{color:var(--faint);padding-right:14px;width:36%;overflow-wrap:normal}
.figures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,520px),1fr));gap:18px;margin-top:10px}
figure{margin:0;padding:12px;background:var(--card);border:1px solid var(--rule);border-radius:6px;break-inside:avoid;
min-width:0}
svg{display:block;width:100%;height:auto}text{font:12px 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',
Arial,sans-serif;fill:var(--text)}.frame{fill:none;stroke:var(--frame)}.grid{stroke:var(--grid)}
.bars{fill:var(--bar);stroke:none}.dot{fill:var(--low)}polyline{fill:none;stroke-width:1.3}
polyline.low{stroke:var(--low)}polyline.high{stroke:var(--high)}.high.dot{fill:var(--high)}
@media (max-width:800px){.sections{columns:auto}}
@media (max-width:560px){body{padding:14px 12px 30px}figure{padding:6px}text{font-size:16px}}
@media print{body{max-width:none;padding:0}.sections{columns:auto}.figures{grid-template-columns:1fr 1fr!important;gap:10px}
figure{padding:6px}text{font-size:16px}@page{margin:12mm}}
";

/// Additions for the page of a run.
///
/// Colours represent roles. Colours within one figure differ in lightness, so they remain distinct
/// in greyscale.
pub(super) const RUN_STYLE: &str = "\
:root{--work:#1d4f91;--wait:#eceff3;--block:#f0a45a;--first:#8a8f98;--second:#1565c0;--third:#c2590a;
--sample:#1a1a1a;--fit:#1565c0;--pulse:#d97706;--limit:#b91c1c;--soft:#f5f7fa;--good:#1b6e3c;--on-good:#fff;
--look:#f2c14e;--on-look:#222;--bad:#b3261e;--on-bad:#fff;--none:#e3e6ea;--on-none:#333}
@media (prefers-color-scheme:dark){:root{--work:#7db7f2;--wait:#2c3138;--block:#b4631c;--first:#878d96;--second:#64b5f6;
--third:#ffb74d;--sample:#eeeeee;--fit:#64b5f6;--pulse:#ffb74d;--limit:#ff7b7b;--soft:#1a1d21;--good:#81c995;--on-good:#10240f;
--look:#fdd663;--on-look:#222;--bad:#f28b82;--on-bad:#2a0b08;--none:#3a3f46;--on-none:#e0e0e0}}
@media print{:root{--work:#1d4f91;--wait:#eceff3;--block:#f0a45a;--first:#8a8f98;--second:#1565c0;--third:#c2590a;
--sample:#1a1a1a;--fit:#1565c0;--pulse:#d97706;--limit:#b91c1c;--soft:#fff;--good:#1b6e3c;--on-good:#fff;
--look:#f2c14e;--on-look:#222;--bad:#b3261e;--on-bad:#fff;--none:#e3e6ea;--on-none:#333}}
h1.input{margin-top:34px;padding-top:22px;border-top:2px solid var(--rule)}
h2.group{font-size:18px;margin:26px 0 4px}
.tiles{display:flex;flex-wrap:wrap;gap:10px;margin:12px 0 20px}
.tiles div{background:var(--soft);border:1px solid var(--rule);border-radius:6px;padding:8px 14px;min-width:86px}
.tiles b{display:block;font-size:20px;font-weight:600}.tiles span{color:var(--faint);font-size:13px}
nav ol{columns:3;column-gap:24px;margin:10px 0 16px;padding-left:24px}nav li{margin:2px 0;break-inside:avoid}
.keep{break-inside:avoid}.badge{display:inline-block;border-radius:9px;padding:0 8px;font-size:12px;font-weight:600;line-height:18px;
white-space:nowrap;vertical-align:middle}.badge.good{background:var(--good);color:var(--on-good)}
.badge.look{background:var(--look);color:var(--on-look)}.badge.bad{background:var(--bad);color:var(--on-bad)}
.badge.none{background:var(--none);color:var(--on-none)}
.checks{list-style:none;margin:2px 0 12px;padding:0;font-size:14px}.checks li{margin:3px 0}
.checks b{font-weight:400}.checks .about{font-size:13px}
.scroll{overflow-x:auto;max-width:100%}.wide th,.wide td{text-align:right;padding:3px 8px;width:auto;
border-top:1px solid var(--rule);overflow-wrap:normal;white-space:nowrap}.wide th{font-weight:600;vertical-align:bottom}
.wide th:first-child,.wide td:first-child,.wide .text{text-align:left}
.wide td.text{white-space:normal;min-width:16em;overflow-wrap:anywhere}.wide{margin-bottom:14px}
.wide td{font-variant-numeric:tabular-nums}
figure .wide{font-size:13px;margin:8px 0 0}
figcaption{color:var(--faint);font-size:13px;margin-top:6px}
.notes{margin:4px 0;padding-left:20px}.notes li{margin:4px 0;overflow-wrap:anywhere}
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
.legend{display:flex;flex-wrap:wrap;gap:4px 18px;list-style:none;padding:0;margin:8px 0;font-size:13px}
.legend li{display:flex;align-items:center;gap:6px}.legend svg{width:32px;flex:none}
.figures{align-items:start;margin-bottom:20px}.chain{margin:0 0 8px}
section p{margin:4px 0}.job{margin-top:34px}summary{font-weight:600;cursor:pointer;margin-bottom:8px}
.job td{font-size:13px}.job td:first-child{width:14%}
@media (max-width:800px){nav ol{columns:1}.job td:first-child{width:36%}}
@media print{h2,h3,h2.group,.checks,summary{break-after:avoid}figure,tr,.checks{break-inside:avoid}section.data{break-inside:auto}
.tiles b{font-size:16px}.scroll{overflow:visible}.wide{font-size:10px}
.wide th,.wide td{padding:2px 3px;white-space:normal}.wide td:first-child{overflow-wrap:anywhere}
.wide td.text{min-width:10em}figure .wide{font-size:9px}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
";
