"""The page's style sheet: light, one column, numbers in line, readable in print."""

ANSWERS = {"AGREES": "#00724F", "NAMED": "#005A8E", "CLASS": "#8A5A00", "UNEXPLAINED": "#A84300", "NOT_REPEATABLE": "#5B4A8A"}

SHEET = """
:root{--ink:#1f2933;--quiet:#5b6570;--line:#e3e8ee;--soft:#f6f8fa;--tone:#005a8e}
*{box-sizing:border-box}
body{font:16px/1.55 system-ui,-apple-system,"Segoe UI","Helvetica Neue",Arial,sans-serif;color:var(--ink);background:#fff;
margin:0}
main{max-width:1120px;margin:0 auto;padding:0 28px 64px}
header{background:var(--soft);border-top:6px solid var(--tone);border-bottom:1px solid var(--line);margin-bottom:8px}
header>div{max-width:1120px;margin:0 auto;padding:34px 28px 26px}
.small{font-size:13px;color:var(--quiet)}
.mark{display:inline-block;font:600 13px/1 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;letter-spacing:.06em;color:#fff;
background:var(--tone);padding:7px 11px;border-radius:4px}
h1{font-size:38px;line-height:1.15;margin:16px 0 4px;letter-spacing:-.015em;font-weight:700}
.value{font-size:22px;margin:2px 0 10px;color:var(--tone);font-variant-numeric:tabular-nums}
.lead{font-size:18px;max-width:56em;margin:8px 0}
.next{margin:14px 0 0;padding:10px 14px;background:#fff;border:1px solid var(--line);border-left:4px solid var(--tone);
border-radius:4px}
.next b{margin-right:.4em}
.figures{display:grid;grid-template-columns:repeat(4,auto);justify-content:space-between;gap:12px 28px;margin:22px 0 4px}
.figures div b{display:block;font-size:27px;line-height:1.2;font-weight:650;font-variant-numeric:tabular-nums}
.figures div span{font-size:13px;color:var(--quiet)}
.contract{display:grid;grid-template-columns:repeat(5,1fr);gap:8px;margin:22px 0 0}
.contract div{border:1px solid var(--line);border-radius:5px;padding:8px 10px;font-size:12.5px;line-height:1.4;
color:var(--quiet);background:#fff}
.contract b{display:block;font:600 11.5px/1.6 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;letter-spacing:.04em}
.contract .on{border-color:var(--tone);color:var(--ink);box-shadow:inset 0 0 0 1px var(--tone)}
.contract .on b{color:var(--tone)}
section{padding-top:30px}
h2{font-size:22px;margin:0 0 2px;letter-spacing:-.01em}
h3{font-size:16px;margin:18px 0 0}
h2+p{margin:0 0 14px}
p{margin:6px 0 10px;max-width:64em}
p.about{color:var(--quiet);font-size:14.5px}
p.place{font-size:17px;background:var(--soft);border-left:4px solid var(--tone);padding:14px 18px;border-radius:4px;
margin:12px 0 18px;max-width:none}
figure{margin:14px 0 8px}
svg{height:auto;display:block}
svg text{font-family:system-ui,-apple-system,"Segoe UI","Helvetica Neue",Arial,sans-serif!important}
.rank{display:grid;grid-template-columns:minmax(0,1.75fr) minmax(0,1fr);gap:36px;align-items:start}
.rank td.name{min-width:11em;white-space:normal}
.two{display:grid;grid-template-columns:minmax(0,1.15fr) minmax(0,1fr);gap:36px;align-items:start}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums;font-size:14.5px;margin:8px 0}
th,td{padding:7px 12px 7px 0;border-bottom:1px solid var(--line);text-align:left;vertical-align:top}
th{font-weight:600;color:var(--quiet);font-size:13px;border-bottom:1.5px solid #c5ced8;white-space:nowrap}
td.n,th.n{text-align:right;white-space:nowrap;padding-right:18px}
td.keep{white-space:nowrap}
.letter{display:inline-block;width:1.5em;color:var(--quiet);font-weight:400}
td.name{font-weight:600;white-space:nowrap}
.bar{display:inline-block;vertical-align:middle;height:9px;background:var(--line);border-radius:5px;width:64px;
margin-right:8px;overflow:hidden}
.bar i{display:block;height:100%;background:#0072b2}
.tag{font-size:12px;font-weight:600;padding:2px 8px;border-radius:10px;white-space:nowrap;border:1px solid}
.passed{color:#00664a;border-color:#9fd8c3;background:#effaf5}
.failed{color:#9a3d00;border-color:#f0bd98;background:#fef4ec}
.not{color:var(--quiet);border-color:var(--line);background:#fff}
.warn{border-left:4px solid #d55e00;background:#fef4ec;padding:9px 14px;border-radius:4px;margin:8px 0}
ul.plain{margin:6px 0;padding-left:20px}
ul.columns{columns:3;column-gap:32px;font-size:14px}
code{font:13.5px ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;background:var(--soft);padding:1px 5px;border-radius:3px}
footer{border-top:1px solid var(--line);margin-top:44px;padding-top:14px;font-size:13px;color:var(--quiet)}
@media(max-width:820px){table{display:block;overflow-x:auto}
.two,.rank,.contract,.figures{grid-template-columns:1fr}ul.columns{columns:1}h1{font-size:30px}}
@media print{header{background:#fff}section{break-inside:avoid}}
"""
