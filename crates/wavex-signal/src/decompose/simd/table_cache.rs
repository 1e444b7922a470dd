//! Tables of recently used models.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use super::Tables;
use crate::sensor_model::ChannelModel;

/// Number of models whose tables are kept: two for each of two receivers.
const KEPT: usize = 4;

type Known = (ChannelModel, Option<Arc<Tables>>);

/// Tables of the models used last; clones share them.
#[derive(Clone, Default)]
pub struct TableCache(Arc<Mutex<Vec<Known>>>);

impl TableCache {
    /// [`Tables::new`] of this model or of an equal one.
    pub fn of(&self, model: &ChannelModel) -> Option<Arc<Tables>> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, tables)) = known().iter().find(|(of, _)| of == model) {
            return tables.clone();
        }
        // Others need not wait for it.
        let tables = Tables::new(model).map(Arc::new);
        let mut known = known();
        if known.len() == KEPT {
            known.remove(0);
        }
        known.push((model.clone(), tables.clone()));
        tables
    }
}

impl fmt::Debug for TableCache {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TableCache")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::channel;

    #[test]
    fn equal_models_share_tables_and_others_do_not() {
        let model = |noise_sd_dn| channel(&ArNoise::new(&[], noise_sd_dn).unwrap(), 4.0, 5.0);
        let known = TableCache::default();
        let first = known.of(&model(0.7)).unwrap();
        assert!(Arc::ptr_eq(&first, &known.clone().of(&model(0.7)).unwrap()));
        assert!(!Arc::ptr_eq(&first, &known.of(&model(0.8)).unwrap()));
        (0..KEPT).for_each(|k| drop(known.of(&model(1.0 + k as f64))));
        assert!(!Arc::ptr_eq(&first, &known.of(&model(0.7)).unwrap()), "the oldest is forgotten");
    }
}
