/* Maps of msgpack for a program in C: the library msgpack-c packs and unpacks values, and leaves maps to its caller. */
#include <msgpack.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
typedef msgpack_object Object;
static msgpack_sbuffer buffer;
static msgpack_packer packer;
static void text(const char *value) { msgpack_pack_str_with_body(&packer, value, strlen(value)); }
static void fields(const char *form, ...) { /* a form has a key:type for each value; m and a open a map and an array */
  va_list list;
  va_start(list, form);
  char key[40], type;
  for (int used; sscanf(form, " %39[^:]:%c%n", key, &type, &used) == 2; form += used) {
    text(key);
    const double *vector = type == 'v' ? va_arg(list, const double *) : NULL;
    if (type == 'i') msgpack_pack_int64(&packer, va_arg(list, int64_t));
    else if (type == 'd') msgpack_pack_double(&packer, va_arg(list, double));
    else if (type == 's') text(va_arg(list, const char *));
    else if (type == 'b') va_arg(list, int) ? msgpack_pack_true(&packer) : msgpack_pack_false(&packer);
    else if (type == 'm') msgpack_pack_map(&packer, va_arg(list, int));
    else msgpack_pack_array(&packer, vector ? 3 : 0);
    for (int each = 0; vector && each < 3; each++) msgpack_pack_double(&packer, vector[each]);
  }
  va_end(list);
}
static const Object *at(const Object *map, const char *key) { /* the value of a key, NULL where there is none */
  for (uint32_t each = 0; map && map->type == MSGPACK_OBJECT_MAP && each < map->via.map.size; each++) {
    const Object *name = &map->via.map.ptr[each].key;
    size_t size = name->type == MSGPACK_OBJECT_STR ? name->via.str.size : 0;
    if (size == strlen(key) && !memcmp(name->via.str.ptr, key, size)) return &map->via.map.ptr[each].val;
  }
  return NULL;
}
static int64_t whole(const Object *value) { return value && value->type == MSGPACK_OBJECT_POSITIVE_INTEGER ? value->via.i64 : -1; }
static double number(const Object *value) {
  int is_float = value && (value->type == MSGPACK_OBJECT_FLOAT32 || value->type == MSGPACK_OBJECT_FLOAT64);
  return is_float ? value->via.f64 : value && value->type == MSGPACK_OBJECT_NEGATIVE_INTEGER ? (double)value->via.i64 : (double)whole(value);
}
static const char *word(const Object *value, char *into) { /* a text of at most 64 bytes, empty for anything else */
  int size = value && value->type == MSGPACK_OBJECT_STR && value->via.str.size < 65 ? (int)value->via.str.size : 0;
  return into[size] = 0, size ? memcpy(into, value->via.str.ptr, size) : into;
}
static void vector(const Object *value, double *into) {
  int count = value && value->type == MSGPACK_OBJECT_ARRAY && value->via.array.size == 3 ? 3 : 0;
  for (int each = 0; each < count; each++) into[each] = number(&value->via.array.ptr[each]);
}
