//! What is done, what failed, what is open.

use abbe_core::Result;

use crate::manifest::Manifest;

/// The state of a fleet.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Status {
    /// Jobs with a result.
    pub done: usize,
    /// Names of jobs that failed, with the reason.
    pub failed: Vec<(String, String)>,
    /// Names of the others.
    pub open: Vec<String>,
}

/// Looks at the results of all jobs.
///
/// # Errors
/// If the manifest cannot be read, or was changed since it was planned.
pub fn status(manifest: &Manifest) -> Result<Status> {
    let store = manifest.store();
    let mut status = Status::default();
    manifest.each_job(0..manifest.head.jobs, |_, job| {
        if store.has(&job.job) {
            status.done += 1;
        } else if let Some(reason) = job.refused.or_else(|| store.failure(&job.job)) {
            status.failed.push((job.name, reason));
        } else {
            status.open.push(job.name);
        }
        Ok(())
    })?;
    manifest.unchanged()?;
    Ok(status)
}
