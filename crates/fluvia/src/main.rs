//! The command-line program `fluvia`: one file a subcommand.
//!
//! Exit codes: 0 done, 1 failed (one line `error: …` on standard error says why), 2 wrong usage, 130 stopped by
//! Ctrl-C with everything up to there on disk.

mod ablate;
mod bench;
mod compare;
mod convert;
mod curves;
mod data_set;
mod evaluate;
mod frame_source;
mod generate;
mod in_order;
mod inspect;
mod interrupt;
mod mesh;
mod options;
mod plot;
mod plots;
mod record;
mod render;
mod report;
mod resume;
mod simulate;
mod solvers;
mod surface;
mod train;
mod trained;
mod view;
mod warnings;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

/// Simulates fluids as particles: with the learned network of "Lagrangian Fluid Simulation with Continuous
/// Convolutions" (Ummenhofer et al., ICLR 2020), or with divergence-free SPH or position-based fluids.
///
/// Units are metres, seconds and kilograms; y is up.
#[derive(Parser)]
#[command(name = "fluvia", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print nothing but errors and what was asked for.
    #[arg(short, long, global = true, conflicts_with = "verbose", display_order = 100)]
    quiet: bool,
    /// Print more about what is done.
    #[arg(short, long, global = true, display_order = 101)]
    verbose: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Run a scene and write its frames.
    Simulate(simulate::Args),
    /// Make a data set of random scenes.
    Generate(generate::Args),
    /// Train a network on a data set.
    Train(train::Args),
    /// Train and evaluate variants of a training, the paper's ablations for instance.
    Ablate(ablate::Args),
    /// Draw the curves of trainings.
    Plot(plot::Args),
    /// Say how far solvers are from true sequences.
    Evaluate(evaluate::Args),
    /// Say how far two runs of a scene are apart.
    Compare(compare::Args),
    /// Draw frames: a picture, a contact sheet or a film.
    Render(render::Args),
    /// Watch a scene run, or frames, in a browser, and steer it there.
    View(view::Args),
    /// Make surfaces of the liquid in frames, as meshes for Blender, Houdini and ParaView.
    Mesh(mesh::Args),
    /// Say what is in a file, in the directory of a run or in a data set.
    Inspect(inspect::Args),
    /// Convert weights (.pt, .h5) to safetensors.
    Convert(convert::Args),
    /// Time the network on a given state.
    Bench(bench::Args),
    /// Print the completions of a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let report = report::Report::new(cli.quiet, cli.verbose);
    let result = match cli.command {
        Command::Simulate(args) => simulate::run(&args, &report),
        Command::Generate(args) => generate::run(&args, &report),
        Command::Train(args) => train::run(&args, &report),
        Command::Ablate(args) => ablate::run(&args, &report),
        Command::Plot(args) => plot::run(&args, &report),
        Command::Evaluate(args) => evaluate::run(&args, &report),
        Command::Compare(args) => compare::run(&args, &report),
        Command::Render(args) => render::run(&args, &report),
        Command::View(args) => view::run(&args, &report),
        Command::Mesh(args) => mesh::run(&args, &report),
        Command::Inspect(args) => inspect::run(&args, &report),
        Command::Convert(args) => convert::run(&args, &report),
        Command::Bench(args) => bench::run(&args, &report),
        Command::Completions { shell } => {
            // Through memory: the generator panics where its reader closes the pipe.
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "fluvia", &mut script);
            report.result(String::from_utf8_lossy(&script).trim_end()).map(|()| ExitCode::SUCCESS)
        }
    };
    result.unwrap_or_else(|error| {
        report.error(&error);
        ExitCode::FAILURE
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
