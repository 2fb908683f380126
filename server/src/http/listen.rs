//! Accepting connections: a bounded number, with limits on the head of each request, until told to stop.

use super::{Service, router};
use crate::shutdown::Stopping;
use axum::Router;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

/// Serves until the stop, then lets requests in progress end, for as long as the settings say.
pub async fn serve(listener: TcpListener, service: Service) {
    let config = service.scenes.workshop().config.clone();
    let connections = config.connections;
    let open = Arc::new(Semaphore::new(connections as usize));
    let mut stopping = service.stopping.clone();
    let router = router(service.clone());
    loop {
        let accepted = tokio::select! {
            () = stopping.wait() => break,
            accepted = accept(&listener, &open) => accepted,
        };
        let (stream, permit) = accepted;
        // Small messages in both directions decide the latency: never wait to fill a packet.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "TCP_NODELAY");
        }
        let (router, stopping, service) = (router.clone(), stopping.clone(), service.clone());
        let (head_seconds, head_bytes) = (config.head_seconds, config.head_bytes);
        tokio::spawn(async move {
            let workshop = service.scenes.workshop().clone();
            workshop.metrics.connections.add(1);
            serve_one(stream, router, stopping, head_seconds, head_bytes as usize).await;
            workshop.metrics.connections.add(-1);
            drop(workshop);
            // The permit last: once all are back, nothing of any connection is left.
            drop(service);
            drop(permit);
        });
    }
    drop(listener);
    // Every permit back means every connection closed.
    let left = Duration::from_secs(config.shutdown_seconds.into());
    if tokio::time::timeout(left, open.acquire_many(connections)).await.is_err() {
        tracing::warn!("some connections did not end in time and are cut");
    }
}

async fn accept(
    listener: &TcpListener,
    open: &Arc<Semaphore>,
) -> (TcpStream, tokio::sync::OwnedSemaphorePermit) {
    loop {
        // The semaphore is never closed.
        let Ok(permit) = open.clone().acquire_owned().await else { std::future::pending().await };
        match listener.accept().await {
            Ok((stream, _)) => return (stream, permit),
            Err(error) => {
                // Out of file handles, or the client was gone already: breathe, then go on.
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}

async fn serve_one(
    stream: TcpStream,
    router: Router,
    mut stopping: Stopping,
    head_seconds: u32,
    head_bytes: usize,
) {
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(Duration::from_secs(head_seconds.into()))
        .max_buf_size(head_bytes)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = stopping.wait() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection ended badly");
    }
}
