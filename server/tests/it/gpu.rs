//! Viewers of a server that draws on a graphics card, or on what stands for one.

use crate::harness::{Server, Viewer, harmless};
use lumicast_engine::gpu::{AdapterChoice, Gpu};
use serde_json::json;

/// A server that draws on a card; `None`, having said so, where there is none and none is required.
async fn server_on_gpu() -> Option<Server> {
    if let Err(error) = Gpu::open(AdapterChoice::Any) {
        assert!(
            std::env::var("LUMICAST_GPU").as_deref() != Ok("required"),
            "LUMICAST_GPU=required, and {error}"
        );
        eprintln!("SKIPPED: {error}");
        return None;
    }
    Some(Server::start(|config| config.backend = "gpu".into()).await)
}

/// Looks at a viewer's pictures until so many passes were drawn on the card.
async fn passes_on_gpu(server: &Server, viewer: &mut Viewer, least: u64) {
    let passes = &server.scenes.workshop().metrics.passes_gpu;
    while passes.value() < least {
        viewer.frame().await;
    }
}

/// Viewers of every technique are shown pictures by the CPU at once and by the card as soon as it is ready; an edit and a lost device are no
/// more than a pause: all go on to better pictures of the newest scene, which another device draws.
#[tokio::test]
async fn viewers_survive_the_loss_of_the_device() {
    let Some(server) = server_on_gpu().await else { return };
    let mut viewers = Vec::new();
    for (camera, technique) in
        [("main", "path"), ("corner", "octree"), ("main", "irradiance"), ("main", "auto")]
    {
        let mut viewer = server.viewer().await;
        viewer.say(json!({"type": "accuracy", "technique": technique, "target_error": 1e-6})).await;
        viewer.camera(camera, [64, 48]).await;
        viewer.frame().await;
        viewers.push(viewer);
    }
    passes_on_gpu(&server, &mut viewers[0], 10).await;
    let card = server.scenes.workshop().card.gpu().unwrap().clone();
    let before = card.session().unwrap();
    before.lose_for_test();
    let drawn = server.scenes.workshop().metrics.passes_gpu.value();
    for viewer in &mut viewers {
        let (shown, _) = viewer.frame().await;
        viewer.frame_where(|header| header.samples > shown.samples).await;
    }
    passes_on_gpu(&server, &mut viewers[0], drawn + 10).await;
    assert!(card.session().unwrap().generation() > before.generation(), "another device draws");
    let revision = server.edit(harmless(0.5)).await.revision();
    for viewer in &mut viewers {
        viewer.frame_where(|header| header.revision == revision && header.samples >= 2).await;
    }
    let drawn = server.scenes.workshop().metrics.passes_gpu.value();
    passes_on_gpu(&server, &mut viewers[0], drawn + 3).await;
    assert!(server.scenes.workshop().card.gpu().is_some(), "a lost device is no reason to give the card up");
    server.stop().await;
}
