//! The driver: `insitu run`, `status`, `validate`, `new`, `bench`.

fn main() -> std::process::ExitCode {
    insitu::driver::main()
}
