//! Arguments, and the native window.

use clap::Parser;
use lumicast_viewer::app::{App, Options};
use lumicast_viewer::net::Platform;
use lumicast_viewer::screenshot::{Order, Screenshot};
use std::hash::{BuildHasher, RandomState};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::PoisonError;

/// Shows a scene that a Lumicast server keeps lit, and edits it.
#[derive(Debug, Parser)]
#[command(name = "lumicast-viewer", version)]
struct Arguments {
    /// Server, or a scene on it: HOST[:PORT], http://HOST:PORT, http://HOST:PORT/v1/scenes/ID
    #[arg(default_value = lumicast_viewer::address::DEFAULT_ADDRESS)]
    url: String,
    /// Scene to watch; without it the only one, or a choice
    #[arg(long, value_name = "ID")]
    scene: Option<String>,
    /// Camera of the scene to begin with; without it the first
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Size of the window
    #[arg(long, value_name = "WxH", default_value = "1440x860", value_parser = size)]
    size: [f32; 2],
    /// Begin without panels (Tab shows them)
    #[arg(long)]
    picture_only: bool,
    /// Draw with OpenGL, or with Vulkan, Metal or DirectX
    #[arg(long, value_enum, default_value = "glow")]
    renderer: Renderer,
    /// Save the window as PNG once the picture is good enough, and end
    #[arg(long, value_name = "FILE.png")]
    screenshot: Option<PathBuf>,
    /// Samples per pixel that are good enough; a converged picture is
    #[arg(long, value_name = "N", default_value_t = 64)]
    screenshot_after_samples: u32,
    /// Seconds after which waiting for them has failed
    #[arg(long, value_name = "S", default_value_t = 120.0)]
    screenshot_patience: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Renderer {
    /// OpenGL; the faster one where there is no graphics card
    Glow,
    /// Vulkan, Metal or DirectX
    #[cfg(feature = "wgpu")]
    Wgpu,
}

fn size(text: &str) -> Result<[f32; 2], String> {
    // Less than this the panels do not fit; more than this no screen has.
    let side = |text: &str| text.parse().ok().filter(|side| (64.0..=16384.0).contains(side));
    let (width, height) = text.split_once('x').ok_or("write WIDTHxHEIGHT, for example 1280x720")?;
    side(width)
        .zip(side(height))
        .map(|(width, height)| [width, height])
        .ok_or_else(|| "sides go from 64 to 16384".into())
}

/// Runs the window until it is closed.
pub(crate) fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let options = Options {
        server: Some(arguments.url),
        scene: arguments.scene,
        camera: arguments.camera,
        picture_only: arguments.picture_only,
    };
    let order = arguments.screenshot.map(|file| Order {
        file,
        samples: arguments.screenshot_after_samples,
        patience_s: arguments.screenshot_patience,
    });
    let (screenshot, outcome) = order.map(Screenshot::new).unzip();
    let native = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("Lumicast")
            .with_app_id("lumicast-viewer")
            .with_inner_size(arguments.size)
            .with_min_inner_size([320.0, 200.0]),
        renderer: match arguments.renderer {
            Renderer::Glow => eframe::Renderer::Glow,
            #[cfg(feature = "wgpu")]
            Renderer::Wgpu => eframe::Renderer::Wgpu,
        },
        ..Default::default()
    };
    let start = web_time::Instant::now();
    let run = eframe::run_native(
        "lumicast-viewer",
        native,
        Box::new(move |cc| {
            let clock = Box::new(move || start.elapsed().as_secs_f64());
            // The hasher's seed is the system's randomness.
            let session = RandomState::new().hash_one(std::process::id());
            let app = App::new(&cc.egui_ctx, options, Box::new(Platform), clock, session);
            Ok(Box::new(match screenshot {
                Some(screenshot) => app.with_screenshot(screenshot),
                None => app,
            }))
        }),
    );
    let outcome = outcome.map(|outcome| outcome.lock().unwrap_or_else(PoisonError::into_inner).take());
    match (run, outcome) {
        (Err(error), _) => fail(&format!("no window: {error}")),
        (Ok(()), Some(Some(Err(reason)))) => fail(&reason),
        (Ok(()), Some(None)) => fail("the window was closed before the screenshot"),
        (Ok(()), _) => ExitCode::SUCCESS,
    }
}

fn fail(reason: &str) -> ExitCode {
    eprintln!("lumicast-viewer: {reason}");
    ExitCode::FAILURE
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_well_formed_and_sizes_are_checked() {
        Arguments::command().debug_assert();
        assert_eq!(size("1280x720"), Ok([1280.0, 720.0]));
        for bad in ["", "1280", "0x0", "1e9x10", "NaNxNaN", "ax10"] {
            assert!(size(bad).is_err(), "{bad}");
        }
    }
}
