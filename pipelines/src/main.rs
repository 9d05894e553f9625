//! The binary.

fn main() -> std::process::ExitCode {
    heliosplat_pipelines::cli::main()
}
