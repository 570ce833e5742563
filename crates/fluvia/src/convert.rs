//! `fluvia convert`: weights of any form to safetensors.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use fluvia_net::weights;

use crate::report::Report;
use crate::trained;

/// Options of `fluvia convert`.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  fluvia convert pretrained_model_weights.pt published.safetensors")]
pub struct Args {
    /// The weights to read: a file (.pt, .h5 or .safetensors), or the name of shipped ones (default, viscosity).
    input: PathBuf,
    /// The file to write; its name ends in .safetensors.
    output: PathBuf,
    /// Replace the file if it exists.
    #[arg(long)]
    overwrite: bool,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let output = args.output.display();
    if args.output.extension().is_none_or(|extension| extension != "safetensors") {
        bail!("{output}: weights are written as safetensors, expected a name that ends in .safetensors");
    }
    if args.output.exists() && !args.overwrite {
        bail!("{output}: exists already, expected --overwrite or another name");
    }
    let weights = trained::load(&args.input)?.0;
    weights::save_safetensors(&args.output, &weights)?;
    report.note(format_args!("{output}: {} parameters", weights.parameters()));
    Ok(ExitCode::SUCCESS)
}
