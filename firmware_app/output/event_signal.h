// SIGUSR1, by which a user asks for an event.
#pragma once

namespace godwit::app {

/// It ends no program any more, and waits to be taken. Before the first thread starts.
void block_event_signal();

/// Whether one waited. Does not wait itself.
bool take_event_signal();

}  // namespace godwit::app
