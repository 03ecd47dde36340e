/* Libraries at run time, and paths and URIs of files. It is a part of nested.h. */
#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <dlfcn.h>
#endif

typedef void (*rf_function)(void);

#if defined(_WIN32)
static void *rf_load(const char *path) {
  wchar_t wide[4096];
  if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 4096)) return 0;
  for (wchar_t *c = wide; *c; ++c)
    if (*c == L'/') *c = L'\\';
  return (void *)LoadLibraryExW(wide, 0, LOAD_WITH_ALTERED_SEARCH_PATH);
}
static void rf_unload(void *library) { FreeLibrary((HMODULE)library); }
static rf_function rf_symbol(void *library, const char *name) {
  return (rf_function)GetProcAddress((HMODULE)library, name);
}
static const char *rf_load_failure(void) { return "the system cannot load it"; }
#else
static void *rf_load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void rf_unload(void *library) { dlclose(library); }
static rf_function rf_symbol(void *library, const char *name) {
  rf_function found;
  *(void **)(void *)&found = dlsym(library, name);
  return found;
}
static const char *rf_load_failure(void) {
  const char *text = dlerror();
  return text ? text : "the system does not say why";
}
#endif

static char *rf_joined(const char *a, const char *b, const char *c) {
  char *text = (char *)malloc(strlen(a) + strlen(b) + strlen(c) + 1);
  if (text) sprintf(text, "%s%s%s", a, b, c);
  return text;
}

/* The path of a file URI, or of a path; none where it is neither. */
static char *rf_path_of(const char *location) {
  const char *from = location;
  if (!strncmp(from, "file:", 5)) {
    from += 5;
    if (!strncmp(from, "//", 2)) {
      from = strchr(from + 2, '/');
      if (!from) return 0;
    }
#if defined(_WIN32)
    if (from[0] == '/' && from[1] && from[2] == ':') ++from;
#endif
  } else {
    return strstr(from, "://") ? 0 : rf_joined(from, "", "");
  }
  char *path = rf_joined(from, "", ""), *to = path;
  for (unsigned code; path && *from; ++from)
    if (*from == '%' && sscanf(from + 1, "%2x", &code) == 1) *to++ = (char)code, from += 2;
    else *to++ = *from;
  if (path) *to = 0;
  return path;
}

/* The file URI of a path, percent-encoded. */
static char *rf_uri_of(const char *path) {
  char *uri = (char *)malloc(3 * strlen(path) + 9), *to = uri;
  if (!uri) return 0;
  to += sprintf(to, "file://%s", path[0] == '/' ? "" : "/");
  for (; *path; ++path) {
    const char c = *path == '\\' ? '/' : *path;
    const int plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || strchr("-._~/:", c);
    if (plain) *to++ = c;
    else to += sprintf(to, "%%%02X", (unsigned)(unsigned char)c);
  }
  *to = 0;
  return uri;
}
