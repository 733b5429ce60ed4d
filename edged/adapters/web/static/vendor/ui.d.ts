export { Fragment, h, render } from "preact";
export { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
export { html } from "htm/preact";
export { batch, computed, effect, signal } from "@preact/signals";
export { FluentBundle, FluentResource } from "@fluent/bundle";
