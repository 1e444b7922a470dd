//! Checks that consecutive stages fit, and suggests missing stages.

use std::collections::VecDeque;
use std::ops::Range;

use toml::Spanned;
use toml::de::DeValue;

use super::JobError;
use super::draft::DraftStage;
use wavex_line::keys::listed;
use wavex_line::scan_line::Kind;
use wavex_line::stage::find_in;
use wavex_line::stage::{RoleName, StageSpec};

/// A stage as far as the check of the chain needs it.
pub(super) struct ChainLink {
    /// Entry in the registry; `None` if the job names an unknown stage.
    pub spec: Option<&'static StageSpec>,
    /// Position of its name in the job.
    pub named_at: Range<usize>,
    /// Whether its keys remove the need for a preceding stage.
    needs_none: bool,
}

impl ChainLink {
    pub(super) fn of(stage: &DraftStage) -> ChainLink {
        let is_said = |(key, word): (&str, &str)| {
            let value = stage.keys.get_ref().get(key).map(Spanned::get_ref);
            matches!(value, Some(DeValue::String(text)) if text.as_ref() == word)
        };
        let needs_none = stage.spec.and_then(|spec| spec.unless).is_some_and(is_said);
        ChainLink { spec: stage.spec, named_at: stage.named_at.clone(), needs_none }
    }

    fn is(&self, name: &str) -> bool {
        self.spec.is_some_and(|spec| spec.name == name)
    }
}

/// Finds errors in the order of the stages; remedies name stages of `known`.
pub(super) fn check(links: &[ChainLink], known: &[&'static StageSpec]) -> Vec<JobError> {
    let mut errors = Vec::new();
    // Kind of the lines after the stages so far; `None` if unknown.
    let mut kind: Option<Kind> = None;
    for (at, link) in links.iter().enumerate() {
        let Some(spec) = link.spec else {
            kind = None;
            continue;
        };
        let chain = ChainStage { links, known, at, spec };
        let problem = match (at, spec.role) {
            (0, RoleName::Source) => None,
            (0, _) => Some(chain.no_source()),
            (_, RoleName::Source) => Some(chain.second_source()),
            _ => chain.wrong_kind(kind).or_else(|| chain.too_early()),
        };
        errors.extend(problem.map(|(problem, help)| JobError::at(link.named_at.clone(), problem).help(help)));
        // After a stage that does not fit, continue as if it did.
        kind = spec.gives(match (kind, spec.accepts) {
            (Some(kind), accepts) if accepts.contains(&kind) => Some(kind),
            (_, &[only]) => Some(only),
            _ => None,
        });
    }
    errors
}

/// A stage at its position in the chain.
struct ChainStage<'c> {
    links: &'c [ChainLink],
    known: &'c [&'static StageSpec],
    at: usize,
    spec: &'static StageSpec,
}

/// Problem and remedy.
type ChainProblem = (String, String);

impl ChainStage<'_> {
    fn no_source(&self) -> ChainProblem {
        let sources = self.known.iter().filter(|spec| spec.role == RoleName::Source);
        let sources: Vec<String> = sources.map(|spec| quoted(spec.name)).collect();
        let problem = format!("`{}` cannot be the first stage: it has no input", self.spec.name);
        (problem, format!("start with a source: {}", listed(&sources, "or")))
    }

    fn second_source(&self) -> ChainProblem {
        let problem = format!("`{}` is a source, but only the first stage can be a source", self.spec.name);
        (problem, "list several inputs in the `path` of one source, or write two jobs".to_owned())
    }

    /// Checks that the stage accepts the kind of its input lines.
    fn wrong_kind(&self, given: Option<Kind>) -> Option<ChainProblem> {
        let given = given.filter(|given| !self.spec.accepts.contains(given))?;
        let takes: Vec<String> = self.spec.accepts.iter().map(Kind::to_string).collect();
        let name = self.spec.name;
        let problem = format!("`{name}` takes {}, but receives {given}", listed(&takes, "or"));
        let help = if let Some(route) = self.route(given) {
            self.completion(&route)
        } else if let Some(place) = self.earlier_place() {
            format!("move it up, {place}")
        } else {
            format!("no stage makes {} of {given}", listed(&takes, "or"))
        };
        Some((problem, help))
    }

    /// Help that brings the stages of a route before this one: moves those that follow, inserts the others.
    fn completion(&self, route: &[&'static StageSpec]) -> String {
        let follows = |spec: &&StageSpec| self.links[self.at..].iter().any(|link| link.is(spec.name));
        let (late, missing): (Vec<&StageSpec>, Vec<&StageSpec>) = route.iter().copied().partition(follows);
        let names = |specs: Vec<&StageSpec>| {
            listed(&specs.iter().map(|spec| quoted(spec.name)).collect::<Vec<_>>(), "and")
        };
        match (missing.is_empty(), late.is_empty()) {
            (_, true) => format!("insert {} before it", names(missing)),
            (true, _) => format!("move {} up, before it", names(late)),
            _ => format!("insert {} and move {} up, before it", names(missing), names(late)),
        }
    }

    /// Checks that a stage required before this one comes before it.
    fn too_early(&self) -> Option<ChainProblem> {
        let (before, behind) = self.links.split_at(self.at);
        let after = self.spec.after;
        let is_one = |link: &&ChainLink| after.iter().any(|name| link.is(name));
        // An unknown stage may be a misspelling of the missing one.
        let needs_none = after.is_empty() || self.links[self.at].needs_none;
        if needs_none || before.iter().any(|link| is_one(&link) || link.spec.is_none()) {
            return None;
        }
        let names: Vec<String> = after.iter().map(|name| quoted(name)).collect();
        let names = listed(&names, "or");
        let problem = format!("`{}` requires {names} before it", self.spec.name);
        let help = match behind.iter().find(is_one).and_then(|link| link.spec) {
            Some(later) => format!("move `{}` up, before it", later.name),
            None => format!("insert {names} before it"),
        };
        Some((problem, help))
    }

    /// Shortest list of stages that converts `given` to an accepted kind.
    ///
    /// Each stage is preceded by the stages that it requires.
    fn route(&self, given: Kind) -> Option<Vec<&'static StageSpec>> {
        let mut open = VecDeque::from([(given, Vec::new())]);
        let mut seen = vec![given];
        while let Some((kind, route)) = open.pop_front() {
            if self.spec.accepts.contains(&kind) {
                return Some(route);
            }
            for &spec in self.known.iter().filter(|spec| spec.accepts.contains(&kind)) {
                let made = spec.makes.unwrap_or(kind);
                if !seen.contains(&made) {
                    seen.push(made);
                    let mut longer = route.clone();
                    longer.extend(self.missing_before(spec, &route));
                    longer.push(spec);
                    open.push_back((made, longer));
                }
            }
        }
        None
    }

    /// The stage required before `spec`, unless an alternative is in the chain or on the route.
    fn missing_before(&self, spec: &StageSpec, route: &[&StageSpec]) -> Option<&'static StageSpec> {
        let in_chain = |name: &&str| self.links[..self.at].iter().any(|link| link.is(name));
        let on_route = |name: &&str| route.iter().any(|spec| spec.name == *name);
        if spec.after.iter().any(|name| in_chain(name) || on_route(name)) {
            return None;
        }
        find_in(self.known, spec.after.first()?)
    }

    /// The last earlier place in the chain whose lines this stage accepts.
    fn earlier_place(&self) -> Option<String> {
        let fits = |kind: Option<Kind>| kind.is_some_and(|kind| self.spec.accepts.contains(&kind));
        let mut kind = None;
        let mut place = None;
        for spec in self.links[..self.at].iter().filter_map(|link| link.spec) {
            // A stage that needs what this one makes.
            if fits(kind) && kind.is_some_and(|kind| !spec.accepts.contains(&kind)) {
                return Some(format!("before `{}`", spec.name));
            }
            kind = spec.gives(kind);
            if fits(kind) {
                place = Some(format!("after `{}`", spec.name));
            }
        }
        place
    }
}

fn quoted(name: &str) -> String {
    format!("`{name}`")
}
