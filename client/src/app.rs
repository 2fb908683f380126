//! The window: pumps messages between line and model, lays out panels and picture.

use crate::address::ServerAddress;
use crate::model::Model;
use crate::net::{Network, Wake, Wire, WireEvent};
use crate::panels::{
    accuracy,
    connection::{self, BannerWish, ConnectDialog, Wish},
    effects::EffectsPanel,
    form, help, inspector, messages,
    scene::TreePanel,
    statistics, status,
};
use crate::picture::Canvas;
use crate::screenshot::Screenshot;
use crate::theme;
use crate::viewport::Viewport;
use egui::{
    Align, CentralPanel, CollapsingHeader, Frame, Key, KeyboardShortcut, Layout, Margin, Modifiers, Panel,
    RichText, ScrollArea, Ui,
};
use lumicast_protocol::SceneId;
use std::sync::Arc;
use std::time::Duration;

/// Undo and redo as everywhere.
const UNDO: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND, Key::Z);
const REDO: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND.plus(Modifiers::SHIFT), Key::Z);
const CAMERA_KEYS: [Key; 9] =
    [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];

/// What the command line or the page asks for.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Address of a server; the default one if absent.
    pub server: Option<String>,
    /// Scene to watch; the only one, or a choice, if absent.
    pub scene: Option<String>,
    /// Camera to begin with; the scene's first if absent.
    pub camera: Option<String>,
    /// Whether the panels are hidden at first.
    pub picture_only: bool,
}

/// Seconds since some moment, never going back.
pub type Clock = Box<dyn Fn() -> f64>;

/// The whole viewer.
pub struct App {
    network: Box<dyn Network>,
    clock: Clock,
    /// The state; public so that tests can look at it.
    pub model: Model,
    wire: Option<Box<dyn Wire>>,
    watched: Option<(ServerAddress, SceneId)>,
    dialog: ConnectDialog,
    viewport: Viewport,
    tree: TreePanel,
    effects: EffectsPanel,
    show_help: bool,
    show_panels: bool,
    screenshot: Option<Screenshot>,
}

impl App {
    /// Starts looking for what the options name. `session` is a random number.
    pub fn new(
        ctx: &egui::Context,
        options: Options,
        network: Box<dyn Network>,
        clock: Clock,
        session: u64,
    ) -> Self {
        theme::apply(ctx);
        let mut app = Self {
            network,
            clock,
            model: Model::new(session, options.camera),
            wire: None,
            watched: None,
            dialog: ConnectDialog::new(options.server),
            viewport: Viewport::default(),
            tree: TreePanel::default(),
            effects: EffectsPanel::default(),
            show_help: false,
            show_panels: !options.picture_only,
            screenshot: None,
        };
        let wish = match (app.dialog.submit(), options.scene) {
            (Some(Wish::List(address) | Wish::Open(address, _)), Some(scene)) => match SceneId::new(scene) {
                Ok(scene) => Some(Wish::Open(address, scene)),
                Err(error) => {
                    app.dialog.fail(error.to_string());
                    None
                }
            },
            (wish, _) => wish,
        };
        app.fulfil(ctx, wish);
        app
    }

    /// Saves the window once a picture is good enough, and ends the program.
    pub fn with_screenshot(mut self, screenshot: Screenshot) -> Self {
        self.screenshot = Some(screenshot);
        self
    }

    fn fulfil(&mut self, ctx: &egui::Context, wish: Option<Wish>) {
        match wish {
            None => {}
            Some(Wish::List(address)) => {
                self.dialog.listing(self.network.get(&address.http("/v1/scenes"), wake(ctx)));
            }
            Some(Wish::Open(address, scene)) => {
                self.dialog.is_open = false;
                self.model.leave_scene((self.clock)());
                self.viewport.clear();
                (self.tree, self.effects) = Default::default();
                self.watched = Some((address, scene));
                self.open_wire(ctx);
            }
        }
    }

    fn open_wire(&mut self, ctx: &egui::Context) {
        if let Some((address, scene)) = &self.watched {
            self.wire = Some(self.network.open(&address.socket(scene), wake(ctx)));
        }
    }

    /// Everything between line and model; also runs while the window is hidden.
    fn pump(&mut self, ctx: &egui::Context) {
        let now_s = (self.clock)();
        let wish = self.dialog.poll();
        self.fulfil(ctx, wish);
        if self.model.take_retry(now_s) {
            self.open_wire(ctx);
        }
        self.receive(now_s);
        if let Some(reason) = self.model.silence(now_s) {
            self.wire = None;
            self.model.socket_lost(&reason, false, now_s);
        }
        self.send(now_s);
        self.ask_for_effects(ctx);
        if let Some(due_s) = self.model.due_s() {
            // Never at once: what is due now and found no room waits for the line, which wakes the window.
            let pause_s = (due_s - now_s).clamp(0.004, 3600.0);
            ctx.request_repaint_after(Duration::from_secs_f64(pause_s));
        }
    }

    fn receive(&mut self, now_s: f64) {
        // What has come until now; what comes meanwhile is for the next frame.
        for _ in 0..crate::net::INCOMING_MAX {
            let Some(event) = self.wire.as_mut().and_then(|wire| wire.poll()) else { return };
            match event {
                WireEvent::Opened => self.model.socket_opened(now_s),
                WireEvent::Text(text) => self.model.apply_text(&text, now_s),
                WireEvent::Closed { reason, is_final } => {
                    self.wire = None;
                    self.model.socket_lost(&reason, is_final, now_s);
                }
                WireEvent::Picture { picture, frame } => {
                    let to_show = self.model.apply_picture(&picture, now_s);
                    if let Some(frame) = frame {
                        self.model.ack(frame);
                    }
                    if let (true, Ok(decoded)) = (to_show, *picture)
                        && let Some(pixels) = decoded.pixels
                    {
                        let canvas = Canvas::after(self.viewport.take_canvas(), &decoded.header, pixels);
                        self.viewport.set_canvas(canvas);
                    }
                }
            }
        }
    }

    fn send(&mut self, now_s: f64) {
        while let Some(wire) = self.wire.as_mut().filter(|wire| wire.has_room()) {
            let Some(message) = self.model.next_message(now_s) else { return };
            wire.send(message.to_json());
        }
    }

    fn ask_for_effects(&mut self, ctx: &egui::Context) {
        let (Some((address, id)), Some(scene)) = (&self.watched, &self.model.scene) else { return };
        let revision = scene.description.revision;
        // While edits follow each other the scene moves on faster than anyone reads.
        if self.model.link.is_open() && !self.model.edits.is_busy() && self.effects.wants(revision) {
            let answer = self.network.get(&address.http(&format!("/v1/scenes/{id}/effects")), wake(ctx));
            self.effects.asked(revision, answer);
        }
    }

    /// The whole window.
    pub fn show(&mut self, ui: &mut Ui) {
        let now_s = (self.clock)();
        let ctx = ui.ctx().clone();
        self.keys(&ctx);
        if self.show_panels {
            self.panels(ui, now_s);
        }
        CentralPanel::no_frame().show(ui, |ui| {
            self.viewport.show(ui, &mut self.model, now_s);
            match connection::banners(ui, &self.model, now_s) {
                Some(BannerWish::RetryNow) => self.model.retry_now(now_s),
                Some(BannerWish::Dismiss) => self.model.notices.dismiss_all(),
                Some(BannerWish::Choose) => {
                    let wish = self.dialog.reopen();
                    self.fulfil(&ctx, wish);
                }
                None => {}
            }
        });
        let can_close = self.watched.is_some();
        let wish = self.dialog.show(&ctx, can_close);
        self.fulfil(&ctx, wish);
        help::show(&ctx, &mut self.show_help);
        // What the hand did goes out with this frame, not with the next.
        self.send((self.clock)());
        if let Some(screenshot) = &mut self.screenshot {
            let frame = self.model.frame.filter(|_| self.viewport.has_picture());
            screenshot.step(&ctx, frame.as_ref(), now_s);
        }
    }

    fn keys(&mut self, ctx: &egui::Context) {
        if ctx.egui_wants_keyboard_input() {
            return;
        }
        let flying = ctx.input(|input| input.pointer.secondary_down());
        let pressed = |key| ctx.input(|input| input.key_pressed(key) && input.modifiers.is_none());
        if ctx.input_mut(|input| input.consume_shortcut(&REDO)) {
            self.model.edits.redo();
        }
        if ctx.input_mut(|input| input.consume_shortcut(&UNDO)) {
            self.model.edits.undo();
        }
        if pressed(Key::F) && !flying {
            self.model.frame_selected();
        }
        if pressed(Key::Home) {
            self.model.frame_all();
        }
        if ctx.input_mut(|input| input.consume_key(Modifiers::NONE, Key::Tab)) {
            self.show_panels = !self.show_panels;
        }
        if pressed(Key::F1) {
            self.show_help = !self.show_help;
        }
        if pressed(Key::Escape) {
            self.show_help = false;
        }
        if let Some(index) = CAMERA_KEYS.iter().position(|key| pressed(*key)) {
            let cameras = self.model.scene.as_ref().map(|scene| scene.description.clone());
            if let Some(camera) = cameras.as_ref().and_then(|scene| scene.cameras.get(index)) {
                self.model.go_to_camera(&camera.id);
            }
        }
    }

    fn panels(&mut self, ui: &mut Ui, now_s: f64) {
        let frame = Frame::new().fill(theme::PANEL).inner_margin(Margin::symmetric(10, 6));
        Panel::top("top").frame(frame).show(ui, |ui| self.top_bar(ui));
        Panel::bottom("status").frame(frame).show(ui, |ui| status::show(ui, &self.model, now_s));
        Panel::left("scene").frame(frame).default_size(290.0).size_range(220.0..=480.0).resizable(true).show(
            ui,
            |ui| {
                let frame = Frame::new().inner_margin(Margin { top: 6, ..Margin::ZERO });
                let half = ui.available_height() * 0.55;
                Panel::bottom("inspector")
                    .frame(frame)
                    .default_size(half)
                    .min_size(120.0)
                    .resizable(true)
                    .show(ui, |ui| {
                        // A panel takes the size of what it holds; this one keeps the size it was dragged to.
                        ui.set_min_size(ui.available_size());
                        inspector::show(ui, &mut self.model, now_s);
                    });
                CentralPanel::no_frame().show(ui, |ui| self.tree.show(ui, &mut self.model));
            },
        );
        Panel::right("light")
            .frame(frame)
            .default_size(318.0)
            .size_range(280.0..=480.0)
            .resizable(true)
            .show(ui, |ui| {
                ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| self.right_panel(ui, now_s));
            });
    }

    fn right_panel(&mut self, ui: &mut Ui, now_s: f64) {
        let section =
            |title: &str, open: bool| CollapsingHeader::new(RichText::new(title).strong()).default_open(open);
        section("Picture", true).show_unindented(ui, |ui| {
            accuracy::show_picture(ui, &mut self.model);
            form::form(ui, "signs", |ui| {
                form::tick(
                    ui,
                    "Light signs",
                    "A sign in the picture where each light is",
                    &mut self.viewport.show_signs,
                );
            });
        });
        section("Accuracy", true).show_unindented(ui, |ui| accuracy::show_accuracy(ui, &mut self.model));
        section("Statistics", true).show_unindented(ui, |ui| statistics::show(ui, &self.model, now_s));
        section("Effects", false).show_unindented(ui, |ui| self.effects.show(ui, &mut self.model));
        let count = messages::count(&self.model);
        let title = if count == 0 { "Messages".to_owned() } else { format!("Messages ({count})") };
        let header = CollapsingHeader::new(RichText::new(title).strong()).id_salt("messages");
        header.show_unindented(ui, |ui| messages::show(ui, &self.model));
    }

    fn top_bar(&mut self, ui: &mut Ui) {
        let server = self.watched.as_ref().map_or(String::new(), |(address, _)| address.label());
        ui.horizontal(|ui| {
            ui.label(RichText::new("Lumicast").strong().size(15.0).color(theme::ACCENT));
            ui.add_space(8.0);
            let scene = self.model.scene.as_ref().map(|scene| scene.description.name.clone());
            let name = scene.or_else(|| self.watched.as_ref().map(|(_, id)| id.to_string()));
            if ui
                .button(name.unwrap_or_else(|| "Connect …".into()))
                .on_hover_text("Another scene or server")
                .clicked()
            {
                let wish = self.dialog.reopen();
                self.fulfil(&ui.ctx().clone(), wish);
            }
            connection::pill(ui, &self.model, &server);
            ui.label(RichText::new(&server).small().color(theme::WEAK));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui.button("Help").on_hover_text("Mouse and keys (F1)").clicked() {
                    self.show_help = !self.show_help;
                }
                if ui.button("Show all").on_hover_text("The whole scene (Home)").clicked() {
                    self.model.frame_all();
                }
                let edits = &mut self.model.edits;
                let redo = ui.add_enabled(edits.can_redo(), egui::Button::new("Redo"));
                if redo.on_hover_text("Ctrl + Shift + Z").clicked() {
                    edits.redo();
                }
                let undo = ui.add_enabled(edits.can_undo(), egui::Button::new("Undo"));
                if undo.on_hover_text("Ctrl + Z").clicked() {
                    edits.undo();
                }
                if let Some(followed) =
                    self.model.viewpoint().and_then(|viewpoint| viewpoint.follows.as_ref())
                {
                    ui.label(RichText::new(format!("camera {followed}")).color(theme::WEAK));
                }
            });
        });
    }
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &egui::Context, _frame: &mut eframe::Frame) {
        self.pump(ctx);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    #[cfg(target_arch = "wasm32")]
    fn as_any_mut(&mut self) -> Option<&mut dyn std::any::Any> {
        Some(&mut *self)
    }
}

fn wake(ctx: &egui::Context) -> Wake {
    let ctx = ctx.clone();
    Arc::new(move || ctx.request_repaint())
}
