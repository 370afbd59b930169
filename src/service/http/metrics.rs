//! `/metrics`, for Prometheus.

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::AppState;

const OPEN_METRICS_CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

pub fn metrics_routes() -> Router<AppState> {
    Router::new().route("/metrics", get(serve_metrics))
}

async fn serve_metrics(State(app): State<AppState>) -> Response {
    for machine in app.machines.iter() {
        let gate = &machine.gate;
        app.metrics.set_machine(&machine.name, &gate.machine_state(), gate.progress_age());
    }
    match app.metrics.text() {
        Ok(text) => ([(CONTENT_TYPE, OPEN_METRICS_CONTENT_TYPE)], text).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
