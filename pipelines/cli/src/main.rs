//! The binary.

/// Keeps the megabytes that every training step hands back; the system's allocator returns them to the kernel, which clears them
/// page by page when they are asked for again.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    heliosplat_cli::command_line::main()
}
