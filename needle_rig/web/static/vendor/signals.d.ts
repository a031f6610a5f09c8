export interface Signal<T> { value: T; peek(): T; }
export function signal<T>(value: T): Signal<T>;
export function computed<T>(compute: () => T): { readonly value: T };
export function effect(run: () => void): () => void;
export function untracked<T>(run: () => T): T;
export function batch<T>(run: () => T): T;
export function useSignal<T>(value: T): Signal<T>;
