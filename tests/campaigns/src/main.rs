//! Runs a campaign: `machines` or `tango`, the number of cases, the seed. Ends with status 1 if a law is broken. `machine`, the
//! number of a case, the seed and a folder write one case there.

use std::process::ExitCode;

use abbe_campaigns::{machines, tango};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| arguments.get(index).and_then(|text| text.parse::<u64>().ok());
    if let (Some("machine"), Some(case), Some(seed), Some(folder)) =
        (arguments.first().map(String::as_str), number(1), number(2), arguments.get(3))
    {
        std::fs::create_dir_all(folder).expect("the folder can be made");
        machines::write(seed, case, folder.as_ref());
        return ExitCode::SUCCESS;
    }
    let report = match (arguments.first().map(String::as_str), number(1), number(2)) {
        (Some("machines"), Some(count), Some(seed)) => machines::run(seed, count),
        (Some("tango"), Some(count), Some(seed)) => tango::run(seed, count),
        _ => {
            eprintln!("usage: abbe-campaigns machines|tango COUNT SEED, or machine CASE SEED FOLDER");
            return ExitCode::from(2);
        }
    };
    print!("{}", report.text);
    if report.broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
