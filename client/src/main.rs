//! `lumicast-viewer`: the viewer as a program, and as the start of the viewer in a page.

#[cfg(not(target_arch = "wasm32"))]
mod cli;

#[cfg(not(target_arch = "wasm32"))]
fn main() -> std::process::ExitCode {
    cli::main()
}

/// Runs in the canvas `lumicast`; the page's own server is the default, `?scene=ID&camera=NAME` say the rest.
#[cfg(target_arch = "wasm32")]
fn main() {
    use lumicast_viewer::{app, net};
    use wasm_bindgen::JsCast;
    wasm_bindgen_futures::spawn_local(async {
        let Some(window) = web_sys::window() else { return };
        let query = window.location().search().unwrap_or_default();
        let parameter = |name: &str| {
            let mut pairs = query.trim_start_matches('?').split('&').filter_map(|pair| pair.split_once('='));
            pairs.find(|(key, _)| *key == name).map(|(_, value)| value.to_owned())
        };
        let options = app::Options {
            server: parameter("server").or_else(|| window.location().origin().ok()),
            scene: parameter("scene"),
            camera: parameter("camera"),
            ..Default::default()
        };
        let canvas = window.document().and_then(|document| document.get_element_by_id("lumicast"));
        let Some(canvas) = canvas.and_then(|element| element.dyn_into().ok()) else { return };
        let start = web_time::Instant::now();
        let clock = Box::new(move || start.elapsed().as_secs_f64());
        let session = (js_sys::Math::random() * u64::MAX as f64) as u64;
        let make: eframe::AppCreator<'_> = Box::new(move |cc| {
            Ok(Box::new(app::App::new(&cc.egui_ctx, options, Box::new(net::Platform), clock, session)))
        });
        // A page without WebGL shows eframe's own message.
        let _ = eframe::WebRunner::new().start(canvas, eframe::WebOptions::default(), make).await;
    });
}
