// Every key of the configuration, and what must hold between keys.
#pragma once

#include <vector>

#include "firmware_app/config/config.h"
#include "firmware_app/config/config_keys.h"

namespace godwit::app {

/// The keys, writing into *config, in the order of config/godwit.toml. A new key is one line here, a member of Config
/// and an entry in config/godwit.toml; tests compare the three.
std::vector<Key> config_keys(Config* config);

/// Looks at a configuration whose every value is allowed by itself for values that cannot stand together. Pure.
void check_contradictions(ConfigReport* report);

}  // namespace godwit::app
