//! Files of other software: what each says becomes columns that existing artefacts take.

mod dmis;
mod inspection;
mod probe;
mod qif;
mod table;

#[cfg(test)]
mod tests;
