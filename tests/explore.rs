mod common;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Write;
use wavex::batch::*;
use wavex::stage::*;
#[derive(Clone, Deserialize, Serialize, JsonSchema)]
struct Dump { path: String }
impl Config for Dump {}
impl SinkConfig for Dump {
    fn outputs(&self) -> Vec<&str> { vec![] }
    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> { Ok(Box::new(D(site.create(&self.path)?))) }
}
struct D(OutputFile);
impl Sink for D {
    fn write(&mut self, b: &Batch, _cx: &mut Context) -> Result<()> {
        for (r, p) in b.returns().unwrap().iter().zip(b.points().unwrap()) {
            let e = &b.emissions[r.emission as usize];
            writeln!(self.0, "{},{},{},{},{},{:.6},{:.6},{:.6},{:.4},{:.4},{:.4},{:.4},{:.4},{:.6},{:.6},{:.6},{},{},{:.6},{:.6}", e.shot, b.line, e.gps_time_s, r.return_number, r.number_of_returns, r.time_of_flight_ns, r.time_of_flight_sd_ns, r.range_m, r.amplitude_dn, r.amplitude_sd_dn, r.amplitude_db, r.fwhm_ns, r.deviation_ratio, p[0], p[1], p[2], r.flags, r.width_ratio, e.emission_ns, e.frame_scale).unwrap();
        }
        Ok(())
    }
    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> { cx.keep(self.0.finish()?); Ok(()) }
}
const DUMP: StageSpec = StageSpec::sink::<Dump>("dump", &[Kind::Points]);
#[test]
fn explore() {
    use wavex::stages::*;
    let data = std::env::var("WAVEX_DATA").unwrap();
    for (spec, path, out) in [(&read_pulsewaves::STAGE, "riegl_q680i_dev/riegl_q680i_dev.pls", "q_pls"), (&read_las::STAGE, "riegl_q680i_dev/riegl_q680i_dev.las", "q_las"), (&read_pulsewaves::STAGE, "pulsewaves/riegl_example3.pls", "ex3")] {
        let job = common::job(&[(spec, &format!("path='{data}/{path}'")), (&calibrate::STAGE, ""), (&decompose::STAGE, ""), (&georeference::STAGE, ""), (&write_las::STAGE, &format!("path='{out}.laz'")), (&DUMP, &format!("path='{out}.csv'"))]);
        let report = wavex::engine::run(&job, &common::into(&job, std::path::Path::new("/tmp/explore"))).unwrap();
        println!("{}", report.inputs[0].table());
        println!("{:#?}", report.inputs[0].totals);
        println!("{}", serde_json::to_string_pretty(&report.inputs[0].sensor_model).unwrap());
        println!("{:?} {:?}", report.inputs[0].group_velocity_mps, report.inputs[0].stages.iter().map(|s| (&s.id, &s.rejected, &s.notes)).collect::<Vec<_>>());
    }
}
