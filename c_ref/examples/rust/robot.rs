//! A robot in Rust that calls the firmware as a shared library. docs/elsewhere.md builds and runs it.
//!
//! Three neighbours report a floor that is black in 83 tiles of 100. The robot itself reads three tiles of
//! four as black, and assumes that its sensor is right 55 times out of 100.

use std::os::raw::c_int;

/// `MCP_ASDF_SIZE_MAX` of mcp_asdf.h: bytes of a robot on any machine, at most.
const ROBOT_SIZE: usize = 184;
/// `MCP_ASDF_ROBUST`, the filter that needs no table.
const ROBUST_FILTER: u8 = 3;
/// 0.55 in units of 2^-32, rounded to nearest, as `MCP_ASDF_PROBABILITY(55, 100)` computes it.
const INITIAL_B_HAT: u32 = (((55 << 32) + 50) / 100_u64) as u32;

/// `mcp_asdf_config_t`. A table of `None` is C's null pointer.
#[repr(C)]
struct Config {
    table: Option<&'static u32>,
    filter_period: u32,
    memory: u32,
    filter: u8,
}

/// `mcp_asdf_t`: memory that the library alone reads and writes, aligned as a 64-bit integer.
#[repr(C, align(8))]
struct Robot {
    memory: [u8; ROBOT_SIZE],
}

#[link(name = "mcp_asdf")]
extern "C" {
    fn mcp_asdf_init(robot: *mut Robot, config: *const Config, id: u8, b_hat: u32) -> c_int;
    fn mcp_asdf_receive(robot: *mut Robot, sender: u8, x_hat: u32, alpha: u32) -> c_int;
    fn mcp_asdf_step(robot: *mut Robot, observation: c_int) -> c_int;
    fn mcp_asdf_x_hat(robot: *const Robot) -> u32;
    fn mcp_asdf_x(robot: *const Robot) -> u32;
    fn mcp_asdf_b_hat(robot: *const Robot) -> u32;
}

/// The robot keeps the address of its settings, so they are static and never move.
static CONFIG: Config = Config {
    table: None,
    filter_period: 100,
    memory: 1 << 31,
    filter: ROBUST_FILTER,
};

fn main() {
    let mut robot = Robot {
        memory: [0; ROBOT_SIZE],
    };
    // Safety: the robot is large enough, it is initialised before any other call, and one thread uses it.
    unsafe {
        let status = mcp_asdf_init(&mut robot, &CONFIG, 7, INITIAL_B_HAT);
        assert_eq!(status, 0, "mcp_asdf_init refuses the settings");
        for tick in 0..300 {
            for sender in 0..3 {
                let x_hat = 7_000_000 + 1000 * u32::from(sender) + tick;
                mcp_asdf_receive(&mut robot, sender, x_hat, 0x8000_0010);
            }
            let is_black = tick % 4 != 0;
            mcp_asdf_step(&mut robot, c_int::from(is_black));
        }
        let (x_hat, x, b_hat) = (mcp_asdf_x_hat(&robot), mcp_asdf_x(&robot), mcp_asdf_b_hat(&robot));
        println!("x_hat {x_hat} x {x} b_hat {b_hat}");
    }
}
