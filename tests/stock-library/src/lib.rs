//! All built-in plugins as a plugin library: what registers when it is linked registers when it is loaded.

use abbe_bundle as _;

abbe_plugin::export!();
