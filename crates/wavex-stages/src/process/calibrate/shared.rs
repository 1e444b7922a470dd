//! What the inputs of a run share.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

use super::{Preset, load_model};
use wavex_line::stage::Result;
use wavex_line::system::Unpoisoned as _;
use wavex_signal::decompose::TableCache;
use wavex_signal::sensor_model::SensorModel;

/// Origin of a model that is not calibrated.
#[derive(Clone, Debug, PartialEq)]
enum Origin {
    File(PathBuf, Option<(u64, SystemTime)>),
    Preset(Preset),
}

type Given = (Origin, Arc<SensorModel>);

/// The model given last, and tables for its comparison with recordings; clones share them.
#[derive(Clone, Debug, Default)]
pub struct SharedModel {
    given: Arc<Mutex<Option<Given>>>,
    pub(super) tables: TableCache,
}

impl SharedModel {
    /// Model of a file, read again if it has changed.
    ///
    /// # Errors
    /// If it cannot be read or is invalid.
    pub(super) fn load(&self, path: &Path) -> Result<Arc<SensorModel>> {
        let state = path.metadata().ok().and_then(|about| Some((about.len(), about.modified().ok()?)));
        self.of(Origin::File(path.to_owned(), state), || load_model(path))
    }

    /// Model of an instrument type.
    ///
    /// # Errors
    /// If the program's model is invalid.
    pub(super) fn preset(&self, preset: Preset) -> Result<Arc<SensorModel>> {
        self.of(Origin::Preset(preset), || preset.model())
    }

    fn of(&self, origin: Origin, make: impl FnOnce() -> Result<SensorModel>) -> Result<Arc<SensorModel>> {
        let mut given = self.given.lock().unpoisoned();
        if let Some((_, model)) = given.as_ref().filter(|(known, _)| *known == origin) {
            return Ok(Arc::clone(model));
        }
        let model = Arc::new(make()?);
        *given = Some((origin, Arc::clone(&model)));
        Ok(model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_files_are_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.json");
        let mut model = Preset::RieglLmsQ680.model().unwrap();
        let write = |model: &SensorModel| {
            std::fs::write(&path, serde_json::to_string(model).unwrap()).unwrap();
        };
        let shared = SharedModel::default();
        write(&model);
        let first = shared.load(&path).unwrap();
        assert!(Arc::ptr_eq(&first, &shared.clone().load(&path).unwrap()));
        // The file is longer now: a coarse clock does not hide the change.
        model.low_power.as_mut().unwrap().pulse_error_factor = 1.5;
        write(&model);
        let again = shared.load(&path).unwrap();
        assert_eq!(again.low_power.as_ref().unwrap().pulse_error_factor, 1.5);
        let preset = shared.preset(Preset::RieglLmsQ680).unwrap();
        assert!(!Arc::ptr_eq(&again, &preset));
    }
}
