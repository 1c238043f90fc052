//! `evpr top`: the live view.

use super::status::ask;
use crate::args::TopArgs;
use crate::failure::Failure;
use crate::profile::top::View;
use evpr_runtime::{ControlRequest, RunFolder};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

/// How often the instance is asked.
const EVERY: Duration = Duration::from_secs(1);

/// `evpr top`.
pub(crate) fn top(args: &TopArgs) -> Result<ExitCode, Failure> {
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        return Err(Failure::usage(
            "evpr top needs a terminal; evpr status says once how an instance is",
        ));
    }
    // Without an instance there is nothing to see: said before the screen is taken.
    let first = ask(&args.name)?;
    let mut terminal = ratatui::try_init()?;
    let mut view = View::default();
    view.take(first);
    let outcome = watch(&args.name, &mut terminal, &mut view);
    ratatui::restore();
    outcome.map(|()| ExitCode::SUCCESS)
}

fn watch(name: &str, terminal: &mut ratatui::DefaultTerminal, view: &mut View) -> Result<(), Failure> {
    let (done, said) = channel();
    let mut next = Instant::now() + EVERY;
    loop {
        while let Ok(text) = said.try_recv() {
            view.message = text;
        }
        terminal.draw(|frame| view.draw(frame))?;
        if event::poll(next.saturating_duration_since(Instant::now()))? {
            match event::read()? {
                Event::Key(key) if key.kind == KeyEventKind::Press => match key.code {
                    KeyCode::Char('q') | KeyCode::Esc => return Ok(()),
                    KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Ok(()),
                    KeyCode::Up | KeyCode::Char('k') => view.go(-1),
                    KeyCode::Down | KeyCode::Char('j') => view.go(1),
                    KeyCode::Char(' ') | KeyCode::Enter => switch(name, view, &done),
                    KeyCode::Char(digit @ '1'..='9') if view.go_to(digit as usize - '1' as usize) => {
                        switch(name, view, &done);
                    }
                    _ => {}
                },
                _ => {}
            }
        }
        if Instant::now() >= next {
            next = Instant::now() + EVERY;
            match ask(name) {
                Ok(status) => view.take(status),
                Err(failure) => view.gone = Some(failure.text()),
            }
        }
    }
}

/// Switches the chosen member, on a thread of its own: the answer comes when its tick opens.
fn switch(name: &str, view: &mut View, done: &Sender<String>) {
    let Some((member, enabled)) = view.switch() else {
        return;
    };
    let verb = if enabled { "on" } else { "off" };
    view.message = format!("{member}: switching {verb}");
    let (name, done) = (name.to_owned(), done.clone());
    std::thread::spawn(move || {
        let request = ControlRequest::Set {
            members: vec![member.clone()],
            enabled: Some(enabled),
            weight: None,
            unload: false,
        };
        let text = match evpr_runtime::request(&RunFolder::of_instance(&name), &request) {
            Ok(reply) => match (reply.error, reply.from_tick) {
                (Some(error), _) => error,
                (None, Some(tick)) => format!("{member}: {verb} from tick {tick} on"),
                (None, None) => format!("{member}: {verb} from the next tick that opens"),
            },
            Err(e) => e.to_string(),
        };
        let _ = done.send(text);
    });
}
