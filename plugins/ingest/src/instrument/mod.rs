//! Files of other software: what each says becomes columns that existing artefacts take.

mod dmis;
mod inspection;
mod iso230;
mod probe;
mod qif;
mod table;

#[cfg(test)]
mod tests;
