//! `eis-archive verify`: reads archived runs back.

use bench_archive::verify::{VerifiedRun, Verifier};
use serde::Serialize;

use super::arguments::VerifyArgs;
use crate::{
    failure::Failure,
    open::Archive,
    print::{print_json, print_line, print_remark},
};

/// Findings of a verification.
#[derive(Debug, Default, Serialize)]
struct VerifyReport {
    runs: usize,
    files: usize,
    bytes: u64,
    wrong: Vec<String>,
}

pub(super) async fn verify_runs(args: &VerifyArgs) -> Result<(), Failure> {
    let archive = Archive::load(&args.config)?;
    let mut verifier = Verifier::of(&archive.store);
    let found = match args.all {
        true => verify_store(&archive, &mut verifier).await?,
        false => verify_own(&archive, &mut verifier, args).await?,
    };
    let mut report = VerifyReport::default();
    for run in found {
        report.runs += 1;
        report.files += run.files;
        report.bytes += run.bytes;
        report.wrong.extend(run.wrong);
    }
    if args.json {
        print_json(&report)?;
    } else {
        report.print();
    }
    match report.wrong.len() {
        0 => Ok(()),
        wrong => Err(Failure::Differs(format!(
            "{wrong} objects of the archive are not what they should be"
        ))),
    }
}

async fn verify_store(
    archive: &Archive,
    verifier: &mut Verifier<'_>,
) -> Result<Vec<VerifiedRun>, Failure> {
    let mut found = Vec::new();
    for run in archive.store.runs().await? {
        found.push(verifier.run(&run).await?);
    }
    Ok(found)
}

async fn verify_own(
    archive: &Archive,
    verifier: &mut Verifier<'_>,
    args: &VerifyArgs,
) -> Result<Vec<VerifiedRun>, Failure> {
    let mut found = Vec::new();
    for source in archive.sources(&args.runs)? {
        let receipt = archive.receipts.read(&source.name)?;
        let is_here = receipt.store == archive.store.name();
        match receipt.kept.filter(|_| is_here) {
            Some(kept) => found.push(verifier.kept(&kept).await?),
            None if args.runs.is_empty() => {
                print_remark(format_args!("{}: not in the archive yet", source.name));
            }
            None => {
                let why = format!("{}: expected a run in the archive, found none", source.name);
                return Err(Failure::Usage(why));
            }
        }
    }
    Ok(found)
}

impl VerifyReport {
    fn print(&self) {
        let result = match self.wrong.len() {
            0 => "all as they were sent".to_owned(),
            wrong => format!("{wrong} not as they were sent"),
        };
        print_line(format_args!(
            "{} runs, {} files, {} bytes read back: {result}",
            self.runs, self.files, self.bytes
        ));
        for what in &self.wrong {
            print_line(format_args!("  {what}"));
        }
    }
}
