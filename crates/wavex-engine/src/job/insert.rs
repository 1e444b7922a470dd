//! Stages that programs add to a parsed job.

use super::{Job, JobStage};
use wavex_line::scan_line::Kind;
use wavex_line::stage::{Plan, Planned, Result, StageError, StageSpec};

impl Job {
    /// Inserts a stage before the stage at `at`; at the end of the chain if `at` is their number.
    ///
    /// `spec` is made by [`StageSpec::in_code`]. The stage has no keys and is not part of [`Job::text`].
    ///
    /// # Errors
    /// If the place is before the source or past the end, `id` is taken, or the stage does not accept
    /// the lines at that place.
    pub fn insert(&mut self, at: usize, id: &str, spec: &'static StageSpec, plan: Plan) -> Result<()> {
        if at == 0 || at > self.stages.len() {
            return Err(StageError::failed(
                format!("stage {id}: the job has no place {at}"),
                format!("choose a place from 1, after the source, to {}", self.stages.len()),
            ));
        }
        if self.stages.iter().any(|stage| stage.id == id) {
            return Err(StageError::failed(
                format!("stage {id}: another stage of the job has this id"),
                "choose another name",
            ));
        }
        let kind = self.kind_before(at);
        if let Some(kind) = kind.filter(|kind| !spec.accepts.contains(kind)) {
            let accepted: Vec<String> = spec.accepts.iter().map(ToString::to_string).collect();
            return Err(StageError::failed(
                format!("stage {id} accepts {}, but receives {kind}", accepted.join(" or ")),
                format!("insert it at another place of the chain {}", self.chain()),
            ));
        }
        self.stages.insert(at, JobStage { id: id.to_owned(), spec, planned: Planned::without_keys(plan) });
        Ok(())
    }

    /// Kind of the lines that reach the place `at`, if known.
    pub fn kind_before(&self, at: usize) -> Option<Kind> {
        self.stages.iter().take(at).fold(None, |kind, stage| stage.spec.gives(kind))
    }

    /// Adds a stage that receives the lines at the end of the chain, after all stages.
    ///
    /// # Errors
    /// See [`Job::insert`].
    pub fn append(&mut self, id: &str, spec: &'static StageSpec, plan: Plan) -> Result<()> {
        self.insert(self.stages.len(), id, spec, plan)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use wavex_stages::registry::STAGES;

    use super::*;
    use wavex_line::stage::{Context, MakeMap, Map, RoleName, RunContext};

    static IN_CODE: StageSpec = StageSpec::in_code("in_code", RoleName::Map, &[Kind::Returns, Kind::Points]);

    struct Nothing;

    impl MakeMap for Nothing {
        fn make(&self, _: &RunContext) -> Result<Box<dyn Map>> {
            Err(StageError::Stopped)
        }
        fn conclude(&self, _: &mut Context) {}
    }

    fn insert(at: usize, id: &str) -> std::result::Result<String, String> {
        let text =
            "[[stage]]\ntype = 'simulate'\n[[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n";
        let mut job = Job::parse(STAGES, "job.toml", text, &[]).unwrap();
        let done = job.insert(at, id, &IN_CODE, Plan::Map(Arc::new(Nothing)));
        done.map(|()| job.chain()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_stage_is_inserted_where_its_lines_are() {
        let chain = "simulate -> Shots -> calibrate -> decompose -> Returns -> mine";
        assert_eq!(insert(3, "mine"), Ok(chain.to_owned()));
        let problem = "stage mine accepts Returns or Points, but receives Shots; insert it at another place of \
                       the chain simulate -> Shots -> calibrate -> decompose -> Returns";
        assert_eq!(insert(1, "mine"), Err(problem.to_owned()));
        let problem = "stage mine: the job has no place 4; choose a place from 1, after the source, to 3";
        assert_eq!(insert(4, "mine"), Err(problem.to_owned()));
        let problem = "stage calibrate: another stage of the job has this id; choose another name";
        assert_eq!(insert(3, "calibrate"), Err(problem.to_owned()));
    }
}
