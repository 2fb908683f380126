//! Records of irradiance as viewers see and steer them.

use crate::harness::{Server, Viewer, in_time};
use serde_json::json;
use std::time::Duration;

/// As the server marks a record's place.
const DOT: [u8; 3] = [255, 40, 160];

/// Dots in frames from the next on, until there are as many as asked for.
async fn dots_where(viewer: &mut Viewer, is_enough: impl Fn(usize) -> bool) -> usize {
    loop {
        let (header, payload) = viewer.frame().await;
        let picture = image::load_from_memory(&payload).unwrap().into_rgb8();
        let dots = picture.pixels().filter(|pixel| pixel.0 == DOT).count();
        if header.size == header.full_size && is_enough(dots) {
            return dots;
        }
    }
}

/// Where records stand is shown to whoever asks for it, and a finer accuracy makes more of them without another camera or edit.
#[tokio::test]
async fn records_are_shown_and_grow_in_number_with_accuracy() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "codec": "png", "show_records": true})).await;
    let accuracy = |of_records: f64| json!({"type": "accuracy", "technique": "irradiance", "target_error": 0.001, "irradiance_accuracy": of_records});
    viewer.say(accuracy(1.0)).await;
    viewer.camera("main", [160, 120]).await;
    let coarse = dots_where(&mut viewer, |dots| dots > 20).await;
    viewer.say(accuracy(0.05)).await;
    let fine = dots_where(&mut viewer, |dots| dots > 3 * coarse).await;
    assert!(fine < 160 * 120, "{fine} for {coarse}");
    viewer.say(json!({"type": "quality", "codec": "png"})).await;
    dots_where(&mut viewer, |dots| dots == 0).await;
    server.stop().await;
}

/// A picture that rests takes up another accuracy: it comes again with other light, and rests again.
#[tokio::test]
async fn a_picture_at_rest_follows_accuracy() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "codec": "png"})).await;
    let accuracy = |of_records: f64| json!({"type": "accuracy", "technique": "irradiance", "target_error": 0.2, "irradiance_accuracy": of_records});
    viewer.say(accuracy(0.1)).await;
    viewer.camera("main", [48, 36]).await;
    let (_, mut before) = viewer.frame_where(|header| header.converged).await;
    // Of two in quick succession the last counts.
    for of_records in [1.0, 0.5, 0.3, 0.1] {
        viewer.say(accuracy(of_records)).await;
        if of_records == 0.5 {
            continue;
        }
        viewer.frame_where(|header| !header.converged).await;
        let (_, after) = viewer.frame_where(|header| header.converged).await;
        assert!(after != before, "the picture of before with a = {of_records}");
        before = after;
    }
    server.stop().await;
}

/// Who comes back is shown what was known when he went, from his first picture on.
#[tokio::test]
async fn light_is_kept_for_who_comes_back() {
    let server = Server::start(|_| {}).await;
    let look = async |is_enough: &dyn Fn(usize) -> bool| {
        let mut viewer = server.viewer().await;
        viewer.say(json!({"type": "quality", "codec": "png", "show_records": true})).await;
        viewer.say(json!({"type": "accuracy", "technique": "irradiance", "target_error": 0.001})).await;
        viewer.camera("main", [32, 24]).await;
        dots_where(&mut viewer, is_enough).await
    };
    let before = look(&|dots| dots > 30).await;
    // Who draws lets go of his picture when he has gone.
    let of_pictures = &server.scenes.workshop().metrics.film_bytes;
    in_time(async {
        while of_pictures.value() > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    let first = look(&|_| true).await;
    assert!(2 * first > before, "{first} records, and {before} before");
    server.stop().await;
}
