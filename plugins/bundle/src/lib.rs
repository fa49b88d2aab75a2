//! The one list of plugins that the stock binary links.
//!
//! A plugin crate that nothing names is left out by the linker, and its registration with it; naming it here is what
//! makes it part of Abbe. A new built-in plugin is a new folder under `plugins/` and one line below.

use abbe_acceptance as _;
use abbe_axis_tables as _;
use abbe_ball_bar as _;
use abbe_ball_bar_closed_form as _;
use abbe_balls as _;
use abbe_calibrated_points as _;
use abbe_calibrations as _;
use abbe_certificate as _;
use abbe_columnar as _;
use abbe_control_parameters as _;
use abbe_direct as _;
use abbe_exporters as _;
use abbe_facets as _;
use abbe_gauss_newton as _;
use abbe_ingest as _;
use abbe_length as _;
use abbe_linuxcnc as _;
use abbe_measure as _;
use abbe_monte_carlo as _;
use abbe_poses as _;
use abbe_rapid_verify as _;
use abbe_sequential as _;
use abbe_serial_chain as _;
use abbe_spindle as _;
use abbe_thermal_plugins as _;
use abbe_tools as _;
use abbe_trend_validator as _;
use abbe_validators as _;
