//! Runs a campaign: its name, the number of cases, the seed. Ends with status 1 if a law is broken. `machine` or
//! `batch`, the number of a case, the seed and a folder write one case there.
//!
//! `sizes` has the largest size for a number of cases. Campaigns that start the program start this one again, which is Abbe where `ABBE_CAMPAIGN_PROGRAM` is set.

use std::process::ExitCode;

use abbe_campaigns::{
    bad_inputs, batches, compensation, fleet, fuzz, hostile, machines, signals, sizes, spindle, tango, touches,
};

fn main() -> ExitCode {
    if std::env::var_os("ABBE_CAMPAIGN_PROGRAM").is_some() {
        return abbe::main();
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| arguments.get(index).and_then(|text| text.parse::<u64>().ok());
    if let (Some(kind @ ("machine" | "batch")), Some(case), Some(seed), Some(folder)) =
        (arguments.first().map(String::as_str), number(1), number(2), arguments.get(3))
    {
        std::fs::create_dir_all(folder).expect("the folder can be made");
        match kind {
            "machine" => drop(machines::write(seed, case, folder.as_ref())),
            _ => batches::write(seed, case, folder.as_ref()),
        }
        return ExitCode::SUCCESS;
    }
    if let (Some("fuzz-seeds"), Some(folder)) = (arguments.first().map(String::as_str), arguments.get(1)) {
        fuzz::write_seeds(folder.as_ref());
        return ExitCode::SUCCESS;
    }
    let program = std::env::current_exe().expect("this program has a file");
    let report = match (arguments.first().map(String::as_str), number(1), number(2)) {
        (Some("machines"), Some(count), Some(seed)) => machines::run(seed, count),
        (Some("batches"), Some(count), Some(seed)) => batches::run(seed, count),
        (Some("compensation"), Some(count), Some(seed)) => compensation::run(seed, count),
        (Some("tango"), Some(count), Some(seed)) => tango::run(seed, count),
        (Some("bad-inputs"), Some(count), Some(seed)) => bad_inputs::run(&program, seed, count),
        (Some("signals"), Some(count), Some(seed)) => signals::run(&program, seed, count),
        (Some("hostile"), Some(count), Some(seed)) => hostile::run(&program, seed, count),
        (Some("fuzz"), Some(count), Some(seed)) => {
            fuzz::run(seed, count, arguments.get(3).map(String::as_str), "target/fuzz".as_ref())
        }
        (Some("fleet"), Some(count), Some(seed)) => fleet::run(&program, seed, count),
        (Some("sizes"), Some(largest), Some(_)) => sizes::run(&program, largest),
        (Some("spindle"), Some(count), Some(seed)) => spindle::run(&program, seed, count),
        (Some("touches"), Some(count), Some(seed)) => touches::run(&program, seed, count),
        _ => {
            eprintln!(
                "usage: abbe-campaigns machines|batches|compensation|tango|bad-inputs|signals|hostile|fleet|sizes|spindle|touches COUNT SEED, fuzz COUNT SEED [TARGET], fuzz-seeds FOLDER, or machine|batch CASE SEED FOLDER"
            );
            return ExitCode::from(2);
        }
    };
    print!("{}", report.text);
    if report.broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
