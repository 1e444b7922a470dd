//! The table `[job.survey]`: limits of the page of a survey.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::keys::Keys;

/// Cells and limits of the survey's page: the table `[job.survey]`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SurveyKeys {
    /// Files of the cells of each strip in the output folder, for `wavex survey`: ends in
    /// `*_cells.arrow`, such as `qc/*_cells.arrow`; empty: `*_cells.arrow` with `survey_page`, else
    /// none. The pulse density of the strip is next to it.
    #[schemars(extend("x-file" = "output"))]
    pub cells: String,
    /// Cell size of densities, roughness and height differences, m. A strip with more than a million
    /// cells doubles it as often as necessary. A cell should have 6 points or more.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub cell_m: f64,
    /// Required pulse density, pulses per m²; the page shows the share of the area below it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.001, max = 10000.0))]
    pub target_pulses_per_m2: Option<f64>,
    /// Largest slope of a smooth cell, degrees.
    #[schemars(range(min = 0.1, max = 60.0))]
    pub max_slope_deg: f64,
    /// Largest standard deviation of the points of a smooth cell from its plane, m.
    #[schemars(range(min = 0.001, max = 10.0))]
    pub max_roughness_m: f64,
    /// Fewest single returns of a smooth cell.
    #[schemars(range(min = 4, max = 1000))]
    pub min_points: u32,
    /// Limit of the RMS of height differences between overlapping strips, m.
    #[schemars(range(min = 0.001, max = 10.0))]
    pub max_difference_rms_m: f64,
    /// Largest width of a gap, m: wider areas without points between strips are outside of the
    /// survey, unless points surround them.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub gap_width_m: f64,
}

impl Default for SurveyKeys {
    /// Limits of quality level 2 of the Lidar Base Specification of the USGS.
    fn default() -> SurveyKeys {
        SurveyKeys {
            cells: String::new(),
            cell_m: 2.0,
            target_pulses_per_m2: None,
            max_slope_deg: 10.0,
            max_roughness_m: 0.1,
            min_points: 6,
            max_difference_rms_m: 0.08,
            gap_width_m: 200.0,
        }
    }
}

/// Name of the cells of a strip; `*` is the stem of the input.
pub const CELLS: &str = "*_cells.arrow";

impl SurveyKeys {
    /// The keys of the table with their documentation.
    pub(super) fn keys() -> Keys {
        Keys::of(SurveyKeys::json_schema)
    }
}
