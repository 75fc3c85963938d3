//! placeholder
use crate::{cli::FitArgs, command::Failure};
/// x
///
/// # Errors
/// x
pub fn fit(_args: &FitArgs) -> Result<(), Failure> {
    Ok(())
}
