//! Stage `evaluate`: figures and report.

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("evaluate", insitu::evaluate::judge)
}
