//! Choosing a server and a scene, the state of the connection, and the banners that speak of it.

use super::numbers;
use crate::address::{DEFAULT_ADDRESS, ServerAddress};
use crate::model::Model;
use crate::model::link::LinkState;
use crate::theme;
use egui::{
    Align, Align2, Button, Color32, Frame, Key, Layout, RichText, ScrollArea, TextEdit, Ui, Vec2, Widget,
};
use lumicast_protocol::{SceneId, SceneList};
use std::sync::mpsc::{Receiver, TryRecvError};

const WIDTH: f32 = 420.0;
/// Longer lists scroll.
const LIST_HEIGHT: f32 = 240.0;

/// What the dialog asks the app to do.
#[derive(Debug, Clone, PartialEq)]
pub enum Wish {
    /// Ask this server for its scenes.
    List(ServerAddress),
    /// Watch this scene.
    Open(ServerAddress, SceneId),
}

/// The dialog's state.
pub struct ConnectDialog {
    /// Whether it stands open.
    pub is_open: bool,
    text: String,
    scene_text: String,
    address: Option<ServerAddress>,
    pending: Option<Receiver<Result<String, String>>>,
    scenes: Option<SceneList>,
    error: Option<String>,
    /// Open the only scene without asking: a person who named a server wants to see something.
    open_only_scene: bool,
}

impl ConnectDialog {
    /// Filled with an address, or with where servers listen by default.
    pub fn new(text: Option<String>) -> Self {
        Self {
            is_open: true,
            text: text.unwrap_or_else(|| DEFAULT_ADDRESS.into()),
            scene_text: String::new(),
            address: None,
            pending: None,
            scenes: None,
            error: None,
            open_only_scene: false,
        }
    }

    /// Whether an answer is awaited.
    pub fn is_waiting(&self) -> bool {
        self.pending.is_some()
    }

    /// As if the person had pressed Connect.
    pub fn submit(&mut self) -> Option<Wish> {
        (self.error, self.scenes, self.pending) = (None, None, None);
        match ServerAddress::parse(&self.text) {
            Ok((address, Some(scene))) => return Some(Wish::Open(address, scene)),
            Ok((address, None)) => {
                self.open_only_scene = true;
                self.address = Some(address.clone());
                return Some(Wish::List(address));
            }
            Err(error) => self.error = Some(error.to_string()),
        }
        None
    }

    /// Opens the dialog on the scenes of the server that is connected.
    pub fn reopen(&mut self) -> Option<Wish> {
        self.is_open = true;
        let wish = self.submit();
        // The person wants to choose.
        self.open_only_scene = false;
        wish.filter(|wish| matches!(wish, Wish::List(_)))
    }

    /// Something is wrong with what was asked for.
    pub fn fail(&mut self, reason: String) {
        (self.is_open, self.error) = (true, Some(reason));
    }

    /// The question for scenes is on its way.
    pub fn listing(&mut self, answer: Receiver<Result<String, String>>) {
        self.pending = Some(answer);
    }

    /// Takes an answer that has come.
    pub fn poll(&mut self) -> Option<Wish> {
        let body = match self.pending.as_ref()?.try_recv() {
            Ok(body) => body,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Err("no answer".into()),
        };
        self.pending = None;
        let server = self.address.as_ref().map_or(String::new(), ServerAddress::label);
        let list = body.map_err(|reason| format!("{server} does not answer: {reason}")).and_then(|body| {
            serde_json::from_str::<SceneList>(&body)
                .map_err(|error| format!("this is no Lumicast server: {error}"))
        });
        match list {
            Ok(list) => {
                let only = if let [only] = list.scenes.as_slice() { Some(only.id.clone()) } else { None };
                self.scenes = Some(list);
                only.filter(|_| self.open_only_scene && self.is_open)
                    .and_then(|scene| Some(Wish::Open(self.address.clone()?, scene)))
            }
            Err(reason) => {
                self.error = Some(reason);
                None
            }
        }
    }

    /// The dialog, over everything.
    pub fn show(&mut self, ctx: &egui::Context, can_close: bool) -> Option<Wish> {
        if !self.is_open {
            return None;
        }
        let mut wish = None;
        let frame = Frame::window(&ctx.global_style()).inner_margin(18.0);
        let modal = egui::Modal::new(egui::Id::unique("connect")).frame(frame);
        let shown = modal.show(ctx, |ui| {
            ui.set_width(WIDTH);
            ui.heading("Connect to a Lumicast server");
            ui.add_space(6.0);
            wish = self.address_line(ui);
            ui.add_space(6.0);
            if let Some(error) = &self.error {
                ui.label(RichText::new(error).color(theme::ERROR));
                ui.label(
                    RichText::new("A server is started with: lumicast serve").small().color(theme::WEAK),
                );
            } else if self.pending.is_some() {
                ui.horizontal(|ui| {
                    ui.spinner();
                    ui.label(RichText::new("asking for its scenes …").color(theme::WEAK));
                });
            }
            wish = self.list(ui).or(wish.take());
            if can_close {
                ui.separator();
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    self.is_open &= !ui.button("Cancel").clicked();
                });
            }
        });
        if can_close && shown.should_close() {
            self.is_open = false;
        }
        wish
    }

    fn address_line(&mut self, ui: &mut Ui) -> Option<Wish> {
        let mut submitted = false;
        ui.horizontal(|ui| {
            let label = ui.label("Address");
            let edit =
                TextEdit::singleline(&mut self.text).hint_text(DEFAULT_ADDRESS).desired_width(WIDTH - 160.0);
            let field = ui.add(edit).labelled_by(label.id);
            submitted = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            submitted |= ui.button("Connect").clicked();
        });
        if submitted { self.submit() } else { None }
    }

    fn list(&mut self, ui: &mut Ui) -> Option<Wish> {
        let (list, address) = (self.scenes.as_ref()?, self.address.clone()?);
        let mut chosen = None;
        if list.scenes.is_empty() {
            ui.label("This server has no scene.");
        }
        ScrollArea::vertical().max_height(LIST_HEIGHT).show(ui, |ui| {
            for scene in &list.scenes {
                let title = if scene.name.is_empty() { scene.id.as_str() } else { &scene.name };
                let facts = format!(
                    "{} triangles · revision {}",
                    numbers::count(scene.triangles as f64),
                    scene.revision
                );
                let button = Button::new((
                    RichText::new(title).strong(),
                    RichText::new(facts).small().color(theme::WEAK),
                ))
                .min_size(Vec2::new(ui.available_width(), 26.0));
                if button.ui(ui).on_hover_text(scene.id.as_str()).clicked() {
                    chosen = Some(Wish::Open(address.clone(), scene.id.clone()));
                }
            }
        });
        // A server may hide its list; who knows the id can say it.
        ui.horizontal(|ui| {
            let label = ui.label(RichText::new("or scene id").color(theme::WEAK));
            let edit =
                TextEdit::singleline(&mut self.scene_text).hint_text("cornell-box").desired_width(180.0);
            let field = ui.add(edit).labelled_by(label.id);
            let entered = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            if entered || ui.add_enabled(!self.scene_text.is_empty(), Button::new("Open")).clicked() {
                match SceneId::new(self.scene_text.trim()) {
                    Ok(id) => chosen = Some(Wish::Open(address, id)),
                    Err(error) => self.error = Some(error.to_string()),
                }
            }
        });
        chosen
    }
}

/// A dot and a word: how the connection is.
pub fn pill(ui: &mut Ui, model: &Model, server: &str) {
    let (colour, text) = match model.link.state() {
        LinkState::Idle => (theme::WEAK, "not connected"),
        LinkState::Connecting if model.link.is_mending() => (theme::ACCENT, "reconnecting"),
        LinkState::Connecting => (theme::ACCENT, "connecting"),
        LinkState::Open => (theme::GOOD, "connected"),
        LinkState::Waiting { .. } => (theme::ACCENT, "connection lost"),
        LinkState::Refused { .. } => (theme::ERROR, "refused"),
    };
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 5.0;
        let (rect, _) = ui.allocate_exact_size(Vec2::splat(9.0), egui::Sense::hover());
        ui.painter().circle_filled(rect.center(), 4.0, colour);
        ui.label(RichText::new(text).color(theme::WEAK)).on_hover_text(server);
    });
}

/// What a banner asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BannerWish {
    /// Do not wait any longer.
    RetryNow,
    /// Another server or scene.
    Choose,
    /// Seen.
    Dismiss,
}

/// Over the picture: the connection is being mended, or something went wrong.
pub fn banners(ui: &Ui, model: &Model, now_s: f64) -> Option<BannerWish> {
    let mut wish = None;
    egui::Area::new(egui::Id::unique("banners"))
        .pivot(Align2::CENTER_TOP)
        .fixed_pos(ui.max_rect().center_top() + Vec2::new(0.0, 10.0))
        .show(ui.ctx(), |ui| {
            wish = connection_banner(ui, model, now_s);
            if let Some(notice) = model.notices.newest_error() {
                banner(
                    ui,
                    theme::ERROR,
                    |ui| {
                        ui.label(RichText::new(&notice.title).strong());
                        if ui.button("Dismiss").clicked() {
                            wish = Some(BannerWish::Dismiss);
                        }
                    },
                    &notice.detail,
                );
            }
        });
    wish
}

fn connection_banner(ui: &mut Ui, model: &Model, now_s: f64) -> Option<BannerWish> {
    let mut wish = None;
    match model.link.state() {
        LinkState::Waiting { until_s, reason } => banner(
            ui,
            theme::ACCENT,
            |ui| {
                let title = if model.link.is_mending() { "Connection lost" } else { "No connection" };
                ui.label(RichText::new(title).strong());
                let seconds = (until_s - now_s).max(0.0).ceil();
                ui.label(RichText::new(format!("trying again in {seconds:.0} s")).color(theme::WEAK));
                if ui.button("Try now").clicked() {
                    wish = Some(BannerWish::RetryNow);
                }
                if ui.button("Other scene …").clicked() {
                    wish = Some(BannerWish::Choose);
                }
            },
            reason,
        ),
        LinkState::Connecting if model.link.failures() > 0 => banner(
            ui,
            theme::ACCENT,
            |ui| {
                ui.spinner();
                ui.label(RichText::new("Reconnecting …").strong());
            },
            "",
        ),
        LinkState::Refused { reason } => banner(
            ui,
            theme::ERROR,
            |ui| {
                ui.label(RichText::new("The server refused the connection").strong());
                if ui.button("Other scene …").clicked() {
                    wish = Some(BannerWish::Choose);
                }
            },
            reason,
        ),
        LinkState::Idle | LinkState::Connecting | LinkState::Open => {}
    }
    wish
}

fn banner(ui: &mut Ui, colour: Color32, head: impl FnOnce(&mut Ui), detail: &str) {
    Frame::popup(ui.style()).stroke(egui::Stroke::new(1.0, colour)).inner_margin(10.0).show(ui, |ui| {
        ui.set_max_width(520.0);
        ui.horizontal(head);
        if !detail.is_empty() {
            ui.label(RichText::new(detail).small().color(theme::WEAK));
        }
    });
}
