//! The page about a run, `report.html`, and what it is made of.
//!
//! [`Run`] holds the results of one run, from memory or from its folder; [`page`] makes one file of one or several runs.
//! It needs nothing from elsewhere and asks for nothing; the same results give the same bytes. It is readable without
//! scripts and on paper.

mod analysis;
mod base64;
mod chart;
mod html;
mod markdown;
pub use abbe_engine::number;
mod page;
mod plan;
mod residuals;
mod run;
mod sections;
mod served;
mod sheet;
mod subset;
mod words;

pub use abbe_volumetric::Known;
pub use analysis::{Analysis, NamedCause, main_fit};
pub use markdown::markdown;
pub use page::page;
pub use plan::plan_page;
pub use residuals::{Residual, Residuals};
pub use run::{Files, FitResult, Run};
pub use sections::{decided, judged, judged_remarks, micrometres, told_figure, undetermined, unit_of, used, valued};
pub use served::{
    KeptCalibration, ListedEntry, ListedMachine, MachinePage, calibration_page, entry_page, machine_page,
    machines_page, refusal_page,
};
pub use sheet::csv;
pub use words::{ErrorGroup, meaning};
