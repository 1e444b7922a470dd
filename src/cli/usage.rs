//! Usage examples at the end of each command's help.

pub(super) const RUN: &str = "\
Examples:
  wavex run flight.toml
  wavex run flight.toml --set decompose.detection_sigma=5 --threads 8
  wavex run flight.toml --profile --archive archives/flight7
  wavex run survey.toml --resume";

pub(super) const PLAN: &str = "\
Examples:
  wavex plan survey.toml -o plan
  wavex plan survey.toml -o plan --cores 8 --archive archives/survey

Run it: snakemake -s plan/Snakefile --profile plan/profiles/slurm";

pub(super) const COLLECT: &str = "\
Examples:
  wavex collect plan
  wavex collect plan --digest";

pub(super) const REPLAY: &str = "\
Examples:
  wavex replay archives/flight7
  wavex replay flight7.tar.zst --inputs /data/2025";

pub(super) const VERIFY: &str = "\
Examples:
  wavex verify archives/flight7
  wavex verify flight7.tar.zst --seal SEAL    (SEAL as printed by `wavex run --archive`)";

pub(super) const CHECK: &str = "\
Examples:
  wavex check flight.toml
  wavex check flight.toml --set job.output_dir=/data/out
  wavex check survey.toml --inputs=required";

pub(super) const STAGES: &str = "\
Examples:
  wavex stages
  wavex stages decompose";

pub(super) const SCHEMA: &str = "\
Example:
  wavex schema > job.schema.json";

pub(super) const INIT: &str = "\
Examples:
  wavex init flight7.pls flight7.toml    a job for this recording
  wavex init flight7.toml                every stage from LAS to points, with all keys
  wavex init flight7.sdf                 to standard output";

pub(super) const CONVERT: &str = "\
Examples:
  wavex convert flight7.pls flight7.arrow
  wavex convert 'lines/*.las' 'out/*.arrow'";

pub(super) const ALIGN: &str = "\
Examples:
  wavex align survey.toml -o aligned
  wavex align survey.toml -o aligned --trajectory 20
  wavex align survey.toml -o aligned --trajectory none
  wavex align survey.toml -o aligned --patches out
  wavex align strip04.laz strip05.laz -o aligned --trajectory linear --apply";

pub(super) const CLASSIFY: &str = "\
Examples:
  wavex classify strip04.laz -o classified.laz
  wavex classify strips -o classified --report classified.json
  wavex classify 'strips/*.laz' -o classified --keep 6,9,17
  wavex classify strips -o classified --dem terrain.tif --cell 0.5
  wavex classify strips -o classified --dem terrain.tif --surface surface.tif --canopy canopy.tif";

pub(super) const CALIBRATE: &str = "\
Examples:
  wavex calibrate flight7.pls
  wavex calibrate level_ground.sdf --save-preset vq780i_1234.json
  wavex calibrate flight7.las --set read_las.full_scale_dn=255 --save-preset model.json
  wavex calibrate survey.toml --out models.json

To use the model of a recording in a job, set `load = \"model.json\"` in the stage `calibrate`; to use
those of a survey, `survey_model = \"models.json\"` in `[job]`.";

pub(super) const COPC: &str = "\
Examples:
  wavex copc flight7.laz
  wavex copc flight7.las --out web/flight7.copc.laz --stac";

pub(super) const FALSE_ALARMS: &str = "\
Examples:
  wavex false-alarms
  wavex false-alarms --correlation 0.6 --sigma 4,4.5,5 --samples 80";

pub(super) const EXPLAIN: &str = "\
Examples:
  wavex explain flight7.pls --shot 1234
  wavex explain flight7.las --time 208801.25 --job flight7.toml --out shot.svg";

pub(super) const SCAN: &str = "\
Examples:
  wavex scan flight7.pls
  wavex scan 'lines/*.sdf' --fast --page
  wavex scan flight7.las --out checks/flight7
  wavex scan 'lines/*.las' --json > lines.jsonl";

pub(super) const VIEW: &str = "\
Examples:
  wavex view flight7.pls
  wavex view flight7.toml --set decompose.detection_sigma=5
  wavex view out/demo --port 8080 --no-open

On another computer: wavex view out/demo --port 8080 --no-open there, ssh -L 8080:localhost:8080 HOST here.";

pub(super) const REPORT: &str = "\
Examples:
  wavex report out/flight7_report.json
  wavex report flight7.toml
  wavex report out --out flight7.html";

pub(super) const SURVEY: &str = "\
Examples:
  wavex survey out
  wavex survey node1 node2 node3 --job survey.toml --out all.html
  wavex survey out --job survey.toml --set job.survey.max_difference_rms_m=0.05";

pub(super) const TRAJECTORY: &str = "\
Examples:
  wavex trajectory flight7.sbet
  wavex trajectory flight7.pof --crs EPSG:2154 --every 10 -o po.txt --svg po.svg
  wavex trajectory positions.txt --columns txyzwpk --time day
  wavex trajectory flight7.sbet --corrections corrections.toml -o corrected.txt";

pub(super) const IMPORT: &str = "\
Examples:
  wavex import -- -i data.sdf -po file.pof -fastest
  wavex import -o job.toml -- -i waveform.las -o points.laz
  wavex import --run -- -i waveform.las -o points.laz";

pub(super) const DOCTOR: &str = "\
Examples:
  wavex doctor";

pub(super) const MAN: &str = "\
Examples:
  wavex man ~/.local/share/man/man1";

pub(super) const COMPLETIONS: &str = "\
Examples:
  mkdir -p ~/.local/share/bash-completion/completions
  wavex completions bash > ~/.local/share/bash-completion/completions/wavex
  wavex completions zsh > ~/.zfunc/_wavex";
