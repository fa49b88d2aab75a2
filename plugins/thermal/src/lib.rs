//! Thermal behaviour from readings that are no geometry: temperatures predicted from few sensors, the drift of a tool.

mod drift;
mod material;
mod prediction;
mod settings;
mod states;
mod validate;
