//! Entry point of the binary `heliosplat`, with its memory allocator.

/// Keeps the megabytes that every training step frees. The system's allocator returns them to the kernel, which clears
/// them page by page at the next allocation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    heliosplat_cli::command_line::main()
}
